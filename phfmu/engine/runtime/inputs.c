/* Inputs of a step: held values, or values at its quadrature nodes carried to substeps; outputs at these
 * nodes. */
#include <string.h>

#include "system.h"

#ifndef PH_WIDTH
int ph_finite(const double *values, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += values[i] - values[i];
    return sum == 0.0;
}

int ph_set_input(ph_instance *in, const double *u) {
    const ph_plan *p = in->model->step;
    if (!ph_finite(u, p->nu))
        return PH_VALUE;
    for (int i = 0; i < p->k; i++)
        for (int j = 0; j < p->nu; j++)
            in->u[i * p->nu + j] = u[j];
    in->head->held = 1;
    in->head->dirty = 1;
    return PH_OK;
}

int ph_set_node_inputs(ph_instance *in, const double *u) {
    const ph_plan *p = in->model->step;
    if (!ph_finite(u, p->nu * p->k))
        return PH_VALUE;
    if (p->nu > 0)
        memcpy(in->u, u, sizeof(double) * (size_t)(p->nu * p->k));
    in->head->held = p->k == 1;
    in->head->theta = 0.0;
    in->head->dirty = 1;
    return PH_OK;
}
#endif

/* in->basis (k) = Lagrange polynomials of the nodes at theta in [0, 1]. */
void ph_basis(ph_instance *in, double theta) {
    const ph_plan *p = in->model->step;
    for (int i = 0; i < p->k; i++) {
        in->basis[i] = 1.0;
        for (int m = 0; m < p->k; m++)
            if (m != i)
                in->basis[i] *= (theta - p->nodes[m]) / (p->nodes[i] - p->nodes[m]);
    }
}

/* u (nu) = interpolation polynomial of the node values at theta in [0, 1]. */
void ph_inputs_at(ph_instance *in, double theta, ph_real *u) {
    const ph_plan *p = in->model->step;
    if (!in->head->held)
        ph_basis(in, theta);
    for (int j = 0; j < p->nu; j++) {
        u[j] = in->u[j];
        if (in->head->held)
            continue;
        u[j] = PH_REAL_SPREAD(0.0);
        for (int i = 0; i < p->k; i++)
            u[j] += in->basis[i] * in->u[i * p->nu + j];
    }
}

/* u (nu*k) = inputs at the nodes of the part [from, from + length] of the step. */
void ph_resample(ph_instance *in, double from, double length, ph_real *u) {
    const ph_plan *p = in->model->step;
    if (p->nu == 0)
        return;
    if (in->head->held || length == 1.0) {
        memcpy(u, in->u, sizeof(ph_real) * (size_t)(p->nu * p->k));
        return;
    }
    for (int i = 0; i < p->k; i++)
        ph_inputs_at(in, from + length * p->nodes[i], u + i * p->nu);
}

/* Adds the outputs y_m at the nodes of the part [from, from + weight] to those of the communication step,
 * y_i += weight sum_m (b_m / b_i) l_i(from + weight c_m) y_m: with inputs u(t) = sum_i l_i(t) u_i at the
 * inner nodes, h sum_i b_i u_i y_i is the energy that was booked. */
void ph_book_nodes(ph_instance *in, double from, double weight) {
    const ph_plan *p = in->model->step;
    const ph_real *y = in->step.r + p->nw;
    if (p->k == 1)
        return;
    if (weight == 1.0) {
        memcpy(in->y_node, y, sizeof(ph_real) * (size_t)(p->nq * p->k));
        return;
    }
    for (int m = 0; m < p->k; m++) {
        ph_basis(in, from + weight * p->nodes[m]);
        for (int i = 0; i < p->k; i++)
            for (int j = 0; j < p->nq; j++)
                in->y_node[i * p->nq + j] +=
                    weight * p->weights[m] / p->weights[i] * in->basis[i] * y[m * p->nq + j];
    }
}
