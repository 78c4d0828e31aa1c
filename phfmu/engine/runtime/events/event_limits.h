/* Limits of the location of state events; the Python engine reads them from here. */
#ifndef PH_EVENT_LIMITS_H
#define PH_EVENT_LIMITS_H

/* Steps taken to land on a zero before there is none (the guard only touches it); so many times more where
 * the guard is known to change its sign, in which every other one halves what is left after the first so
 * many. */
#define PH_LANDING_TRIALS 12
#define PH_LANDING_BRACKETED 10

/* A guard turns back within a step where its rates at the ends say so, and it is no farther from zero than so
 * many times what it would move at the rate at the start. It may have been zero if the least value that they
 * and the values at the ends foretell is beyond zero, or as near to it as this part of its distance from the
 * chord; then steps that end there tell, up to so many, until they move by less than a part of the step. */
#define PH_TURN_REACH 4
#define PH_TURN_NEAR 0.25
#define PH_TURN_TRIALS 12
#define PH_TURN_CLOSE 1e-6

/* A zero is landed on when the next change of the length, or what is left between two lengths with a change
 * of sign, is this many units of rounding of the time. */
#define PH_LANDED 2

/* A guard is zero below the larger of this part of its nominal value and what so many units of rounding of
 * the time make of it; others that are as close to zero at an event, by the second part, happen with it. */
#define PH_GUARD_ZERO 1e-13
#define PH_GUARD_TOGETHER 1e-10
#define PH_GUARD_CLOCK 16

/* Where something has just happened, or a communication step begins, a guard is zero that is off by no more
 * than so many units of rounding of the time make of it: a landing leaves some, clocks that are summed more.
 * In a step of at most PH_GUARD_CLOCK such units guards that are zero stay so. */
#define PH_GUARD_ARRIVED 64

/* A guard that is zero at the start and seems to leave the way that counts is looked at on a step so many
 * times halved, for the polynomial shows its mean rate; then it happens at once. */
#define PH_LEAVING_HALVINGS 20

/* After so many of these halvings it does not leave if it was inside at the end of every step: then only the
 * polynomial was beyond, the chord of an arc. */
#define PH_LEAVING_ARC 2

/* The rest of a step after an event is no step if it is at most so many units of rounding of the time. */
#define PH_REST_OF_STEP 4

/* Events pile up where one follows itself within this part of the step, or where so many fall into one. */
#define PH_PILE_UP 1e-6
#define PH_MOST_EVENTS 100

/* A loss may be negative by this part of the energies that move, rounding. */
#define PH_LOSS_ROUNDING 1e-12

/* Pivots of S this small against its diagonal: the jumps depend on each other. */
#define PH_JUMP_DEPENDENT 1e-12

/* An impulse that only pushes, and what is left of its c, may be negative by this part of what they are made
 * of, rounding. Sets of contacts that push are tried up to so many. */
#define PH_PUSH_ROUNDING 1e-12
#define PH_MOST_PUSHING 4096

#endif
