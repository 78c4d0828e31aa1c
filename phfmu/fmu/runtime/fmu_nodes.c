/* Derivatives of the last communication step with respect to its inputs at nodes and its impulses, over any
 * number of internal steps; only units with inputs at nodes have this file. */
#include <stdlib.h>
#include <string.h>

#include "fmu.h"
#include "pool.h"

int fmu_node_memory(fmu *f) {
    const ph_sizes *p = &f->sizes;
    const fmu_impulses *impulses = f->about->impulses;
    const size_t n = impulses ? (size_t)impulses->n : 0, nu = (size_t)p->nu, k = (size_t)p->k;
    const size_t columns = k * nu + 2 * n, width = (size_t)(p->nx + 1 + p->na);
    const size_t kept = impulses ? ph_padded(impulses->size(f->of, impulses->ports)) : 0;
    fmu_nodes *m = &f->nodes;
    char *block =
        calloc(1, kept + sizeof(double) * (2 * n + n * n + columns * (2 * k * nu + nu + n + width)) + 1);
    if (!block)
        return 0;
    m->memory = block;
    m->columns = (int)columns;
    if (impulses)
        m->impulses = impulses->init(block, f->of, impulses->ports);
    m->s = (double *)(void *)(block + kept);
    m->jump = m->s + 2 * n;
    m->du = m->jump + n * n;
    m->ds = m->du + columns * k * nu;
    m->dx = m->ds + columns * n;
    m->by_node = m->dx + columns * width;
    m->by_end = m->by_node + columns * k * nu;
    return 1;
}

/* Row j of the directions: input j at the nodes, or impulse j of those at the start, then of those at the
 * end. */
static void unit_directions(const fmu *f) {
    const ph_sizes *p = &f->sizes;
    const fmu_nodes *m = &f->nodes;
    const int inputs = p->k * p->nu, width = p->nx + 1 + p->na;
    memset(m->du, 0, sizeof(double) * (size_t)m->columns * (size_t)inputs);
    memset(m->dx, 0, sizeof(double) * (size_t)m->columns * (size_t)width);
    for (size_t j = 0; j < (size_t)inputs; j++)
        m->du[j * (size_t)inputs + j] = 1.0;
}

/* The impulses at the start, or at the end, move the states of all directions on. */
static void through_impulses(const fmu *f, int end) {
    const ph_sizes *p = &f->sizes;
    const fmu_impulses *impulses = f->about->impulses;
    const fmu_nodes *m = &f->nodes;
    const int n = impulses->n, first = p->k * p->nu + end * n;
    memset(m->ds, 0, sizeof(double) * (size_t)m->columns * (size_t)n);
    for (int j = 0; j < n; j++)
        m->ds[(size_t)(first + j) * (size_t)n + (size_t)j] = 1.0;
    impulses->along(m->impulses, end, m->columns, m->ds, m->dx);
}

int fmu_node_map(fmu *f) {
    const fmu_nodes *m = &f->nodes;
    const ph_directions nodes = {.n = m->columns, .du = m->du, .dx = m->dx, .dy = m->by_node};
    const ph_directions ends = {.n = m->columns, .du = m->du, .dx = m->dx, .dy = m->by_end};
    int status;
    unit_directions(f);
    if (!f->about->impulses)
        return ph_step_along(f->of, &nodes);
    through_impulses(f, 0);
    status = ph_step_along(f->of, &nodes);
    if (status)
        return status;
    through_impulses(f, 1);
    return ph_end_along(f->of, &ends);
}
