/* The step map of a model: `of` is its instance, `about` the ph_model. */
#include "step_map.h"

#include "system.h"

static void sizes(const void *about, ph_sizes *s) {
    ph_sizes_of(about, s);
}

static size_t size(const void *about) {
    return ph_size(about);
}

static int init(void *memory, const void *about) {
    return ph_init(memory, about);
}

static int reset(void *of) {
    return ph_reset(of);
}

static int initialise(void *of) {
    return ph_initialise(of);
}

static int refresh(void *of) {
    return ph_refresh(of);
}

static int set_x(void *of, double t, const double *x) {
    return ph_set_x(of, t, x);
}

static int set_parameters(void *of, const double *p) {
    return ph_set_parameters(of, p);
}

static int set_input(void *of, const double *u) {
    return ph_set_input(of, u);
}

static int set_node_inputs(void *of, const double *u) {
    return ph_set_node_inputs(of, u);
}

static int step_parts(void *of, double t, double h, int n) {
    return ph_step_parts(of, t, h, n);
}

static int skip(void *of, double t) {
    return ph_skip(of, t);
}

static const double *signals(const void *of) {
    return ph_signals(of);
}

static const double *ledger(const void *of, int row) {
    return ph_ledger(of, row);
}

static const double *parameters(const void *of) {
    return ph_parameters(of);
}

static const double *input(const void *of) {
    return ph_input(of);
}

static const double *node_outputs(const void *of) {
    return ph_node_outputs(of);
}

static const long long *counts(const void *of) {
    return ph_counts(of);
}

static const ph_report *report(const void *of) {
    return ph_last_report(of);
}

static int part(const void *of) {
    (void)of;
    return 0;
}

static int sensitivity(void *of, double *s) {
    return ph_sensitivity(of, s);
}

static int sensitivity_end(void *of, double *s) {
    return ph_sensitivity_end(of, s);
}

static int kept_size(const void *about) {
    return ph_kept_size(about);
}

static void keep(const void *of, double *kept) {
    ph_keep(of, kept);
}

static void join(void *of, const double *kept, double part_of) {
    ph_join(of, kept, part_of);
}

static size_t state_size(const void *of) {
    return ph_state_size(of);
}

static int save(void *of, void *out) {
    ph_save(of, out);
    return PH_OK;
}

static int load(void *of, const void *from) {
    return ph_load(of, from);
}

static const char *state_fault(const void *of, const void *from) {
    return ph_state_fault(of, from);
}

static const double *joined(const void *of) {
    (void)of;
    return NULL;
}

const ph_step_map *ph_map_model(void) {
    static const ph_step_map model = {
        .sizes = sizes,
        .size = size,
        .init = init,
        .reset = reset,
        .initialise = initialise,
        .refresh = refresh,
        .set_x = set_x,
        .set_parameters = set_parameters,
        .set_input = set_input,
        .set_node_inputs = set_node_inputs,
        .step_parts = step_parts,
        .skip = skip,
        .signals = signals,
        .ledger = ledger,
        .parameters = parameters,
        .input = input,
        .node_outputs = node_outputs,
        .counts = counts,
        .report = report,
        .part = part,
        .sensitivity = sensitivity,
        .sensitivity_end = sensitivity_end,
        .kept_size = kept_size,
        .keep = keep,
        .join = join,
        .state_size = state_size,
        .save = save,
        .load = load,
        .state_fault = state_fault,
        .joined = joined,
    };
    return &model;
}
