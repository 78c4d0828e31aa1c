/* Limits of a step and tests of its solvers; the Python engine reads them from here. */
#ifndef PH_STEP_LIMITS_H
#define PH_STEP_LIMITS_H

/* A step this short is what rounding left of a master's clock and no step: in units of eps |t|, and as a part
 * of an internal step. In it multipliers would be the noise of the constraints over h. */
#define PH_SLIVER_CLOCK 2
#define PH_SLIVER_STEP 1e-9

/* Newton iterations an internal step may take, all attempts and substeps together; a communication step may
 * take this and some more for each internal step. */
#define PH_MOST_ITERATIONS 2500
#define PH_MORE_ITERATIONS 100

/* Energies, states and outputs of a step may be this large: sums of a million of them are still finite. */
#define PH_LARGEST 1e302

/* Changes of the constraints at rest that an instance remembers, the last ones. */
#define PH_KEPT_CHANGES 16

/* Internal steps of a communication step that may have been halved if there is to be a sensitivity. */
#define PH_KEPT_HALVED 16

/* Halvings of an internal step before it is given up, and the part of a step whose solution may lead to that
 * of the whole. */
#define PH_DEPTH 6
#define PH_SHORTEST 0.125

/* Newton's method ends when a scaled update, max |dw_i| / (nominal_i + |w_i|), is below the tolerance and the
 * last two say that the polish leaves no more than rounding. */
#define PH_NEWTON_ITERATIONS 30
#define PH_TOLERANCE 1e-9
#define PH_ROUNDING 1e-15

/* Below the first an update that stays is rounding, if the residual is; multipliers feel it as rounding over
 * h. Up to the second it crawls where constraints lose rank, if it shrinks slower than PH_CRAWL. */
#define PH_STAGNATION 1e-4
#define PH_CRAWLING 1e-2
#define PH_CRAWL 0.9

/* An update that shrinks by less than this part is the one before: sums of large states take no notice of it.
 */
#define PH_SAME_UPDATE 1e-9

/* Updates in a row that hardly shrink, to more than PH_SHRINKING; one that has grown by more than PH_GROWN
 * does not stall. */
#define PH_STALLS 2
#define PH_SHRINKING 0.5
#define PH_GROWN 4

/* Updates since the smallest one: after so many they wander, and are rounding if the residual is. */
#define PH_WANDERING 6

/* Units of rounding in a row that cannot be told from zero, and as many times more in constraint rows: sums
 * of values that are themselves computed with cancellation. */
#define PH_FLOOR 64
#define PH_CONSTRAINT_SUMS 16

/* Steps that a kept factor has to serve to be a gain, and steps with factors of their own after one that has
 * not. */
#define PH_SERVED_STEPS 4
#define PH_UNKEPT_STEPS 200

/* Shortest step of the line search. */
#define PH_LEAST_DAMPING 0.015625

/* Delta on the diagonals of multipliers, in the factor only, and no more than this of its column. */
#define PH_DELTA 1e-10
#define PH_DELTA_PART 1e-8

/* Units of rounding of a column that cancels down to them: it depends on the others. */
#define PH_DEPENDENT 4

/* A constraint with less than the largest share in a dependence over this does not rest; one that misses more
 * than this of its natural size is not redundant. */
#define PH_REST_SHARE 3
#define PH_REST_GAP 1e-9

/* Forces of a combination that leave this part of the largest together cancel; forces that differ by less
 * than the second are equal: of these the last constraint rests. Rounds of inverse iteration, which delta
 * bounds by 1e10 each. */
#define PH_REST_CANCELLED 1e-6
#define PH_REST_EQUAL 1e-6
#define PH_REST_ROUNDS 3

#endif
