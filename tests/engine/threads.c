/* Threads that each make and step an instance of their own, then those of the master of coupled members: to
 * be compiled with a model and a checker of threads. What they find is compared with one thread. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "master.h"
#include "native.h"
#include "plan.h"
#include "system.h"

extern const ph_model ph_the_model;

enum { THREADS = 3, INSTANCES = 6, STEPS = 20 };
static const double H = 1e-3;

static void require(int fine, const char *what) {
    if (fine)
        return;
    fprintf(stderr, "%s\n", what);
    exit(3);
}

static void *room(size_t size) {
    void *memory = calloc(1, size + sizeof(double));
    require(memory != NULL, "no memory");
    return memory;
}

static double *reals(int n) {
    return room(sizeof(double) * (size_t)n);
}

/* No two have the same inputs. */
static ph_instance *make(int i) {
    ph_instance *in = room(ph_size(&ph_the_model));
    const int n = ph_the_model.step->nu;
    double *u = reals(n);
    require(ph_init(in, &ph_the_model) == PH_OK, "init");
    for (int j = 0; j < n; j++)
        u[j] = 0.1 * (i + 1);
    require(ph_set_input(in, u) == PH_OK && ph_initialise(in) == PH_OK, "start");
    free(u);
    return in;
}

/* All that a run does, and what it leaves. */
static void *alone(void *number) {
    const int i = *(int *)number, nu = ph_the_model.step->nu;
    ph_instance *in = make(i);
    void *kept = room(ph_state_size(in));
    double *derivatives = reals(nu * nu);
    for (int k = 0; k < STEPS; k++) {
        ph_save(in, kept);
        for (int again = 0; again < 2; again++) {
            require(ph_load(in, kept) == PH_OK && ph_step(in, k * H, H) == PH_OK, "step");
            require(ph_sensitivity(in, derivatives) == PH_OK && ph_refresh(in) == PH_OK, "end of a step");
        }
    }
    require(ph_step_parts(in, STEPS * H, H, 3) == PH_OK, "step in parts");
    ph_save(in, kept);
    free(derivatives);
    free(in);
    return kept;
}

static void instances_of_their_own(void) {
    static void *expected[INSTANCES];
    int number[INSTANCES];
    pthread_t thread[INSTANCES];
    ph_instance *one = make(0);
    const size_t size = ph_state_size(one);
    free(one);
    for (int i = 0; i < INSTANCES; i++) {
        number[i] = i;
        expected[i] = alone(&number[i]);
    }
    for (int i = 0; i < INSTANCES; i++)
        require(pthread_create(&thread[i], NULL, alone, &number[i]) == 0, "thread");
    for (int i = 0; i < INSTANCES; i++) {
        void *found;
        require(pthread_join(thread[i], &found) == 0, "join");
        require(memcmp(expected[i], found, size) == 0, "threads change what an instance finds");
        free(found);
        free(expected[i]);
    }
}

/* A member whose inputs are the unknowns; numbers: 0, 1, .. */
static ph_share share(int i, const int *numbers, const double *ones) {
    const ph_plan *p = ph_the_model.step;
    const int nu = p->nu, width = p->nx + 1 + p->na;
    ph_instance *in = make(i);
    int offset[PH_NBLOCK + 1];
    ph_native *of = room(sizeof(ph_native));
    ph_share s = {.kind = ph_kind_native(), .of = of, .nu = nu, .stride = p->nq, .k = 1, .ncomp = p->ncomp};
    *of = (ph_native){.in = in, .parts = 1, .nq = p->nq, .width = width};
    ph_layout(&ph_the_model, offset);
    of->nsignal = offset[PH_NBLOCK];
    s.length = of->nsignal + 5 * s.ncomp + p->nq;
    s.ninput = s.ncol = s.nrow = s.nright = s.nleft = nu;
    s.col = s.row = s.input = s.right_direction = s.right_col = s.left_output = s.left_row = numbers;
    s.right = s.left = s.weights = s.at_end = ones;
    s.free = reals(nu);
    s.outputs = ph_node_outputs(in);
    of->signals = ph_signals(in);
    s.energies = of->signals + offset[PH_H];
    s.end = of->signals + offset[PH_Y_END];
    of->kept = room(ph_state_size(in));
    s.u = reals(nu);
    s.y = reals(2 * nu);
    of->dx = reals(nu * width + nu * nu);
    s.dy = reals(nu * nu);
    s.across = reals(nu * nu);
    s.record = reals(STEPS * s.length);
    return s;
}

static void *help(void *crew) {
    ph_crew_help(crew);
    return NULL;
}

/* What coupled members do in their steps, by so many threads; what they find, of which `size` are told. */
static double *together(int threads, size_t *size) {
    const int nu = ph_the_model.step->nu;
    int *numbers = room(sizeof(int) * (size_t)(nu + 1)), status[INSTANCES] = {0};
    double *ones = reals(nu + 1), *z = reals(nu), *found, cost[INSTANCES] = {0};
    ph_share shares[INSTANCES];
    ph_master m = {.shares = shares, .nshare = INSTANCES, .nxi = nu, .z = z, .status = status, .cost = cost};
    pthread_t thread[THREADS];
    size_t one, square = (size_t)(nu * nu);
    for (int j = 0; j <= nu; j++) {
        numbers[j] = j;
        ones[j] = 1.0;
    }
    for (int i = 0; i < INSTANCES; i++)
        shares[i] = share(i, numbers, ones);
    m.crew = threads > 1 ? ph_crew_init(room(ph_crew_size())) : NULL;
    for (int i = 1; i < threads; i++)
        require(pthread_create(&thread[i], NULL, help, m.crew) == 0, "thread");
    for (int k = 0; k < STEPS; k++) {
        for (int again = 0; again < 3; again++) {
            for (int j = 0; j < nu; j++)
                z[j] = 0.01 * (k + 1) * (again + j + 1);
            require(ph_shares_step(&m, k * H, H, again ? PH_FROM_KEPT : PH_FROM_HERE, NULL, m.nshare) ==
                        PH_OK,
                    "trial");
            require(ph_shares_along(&m) == PH_OK && ph_shares_refresh(&m) == PH_OK, "derivatives");
        }
        require(ph_shares_finish(&m, k) == PH_OK, "finish");
    }
    if (m.crew)
        ph_crew_end(m.crew);
    for (int i = 1; i < threads; i++)
        require(pthread_join(thread[i], NULL) == 0, "join");
    one = (size_t)(STEPS * shares[0].length);
    *size = sizeof(double) * (one + square) * INSTANCES;
    found = room(*size);
    for (size_t i = 0; i < INSTANCES; i++) {
        memcpy(found + i * (one + square), shares[i].record, sizeof(double) * one);
        memcpy(found + i * (one + square) + one, shares[i].across, sizeof(double) * square);
    }
    return found;
}

int main(void) {
    size_t size;
    double *expected, *found;
    instances_of_their_own();
    expected = together(1, &size);
    found = together(THREADS, &size);
    require(memcmp(expected, found, size) == 0, "the number of threads changes what members find");
    puts("same bits");
    return 0;
}
