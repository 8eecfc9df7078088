/* F = Λ Ω a + Ω̄ f + μ + p (O. Khatib, A unified approach for motion and force control of robot
 * manipulators, IEEE J. Robotics and Automation 3, 1987) inside the compiled tick, between the command
 * and its allocation to the motors. Ω̄ selects wrenches and Ω = 1 − Ω̄ᵀ accelerations.
 *
 * In turned energy coordinates the object's metric is 1, and the arms lock the first m axes, where the
 * acceleration is σ. Along the others it is
 *
 *     the e nearest to y = Ω a with Wᵀ(σ, e) = WᵀΩ a = 0,
 *
 * W the selected unit wrenches: what the arms can do of Ω a without an acceleration along W. Beyond the
 * motors' limits torques are those of the controller's own quadratic program.
 */
#include "osc_selection.h"
#include "osc_controller.c"

static void cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static double product(const double *a, const double *b, int count) {
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += a[i] * b[i];
    return sum;
}

/* Rows of A: from wrenches at O in world axes to turned energy coordinates. */
static void wrench_map(unsigned char *work, double A[6][6]) {
    const double *axes = numbers(work, WORK_axes) + 18, *C = numbers(work, WORK_p_C), *O = numbers(work, WORK_p_O);
    const double *v = numbers(work, WORK_reflectors), *beta = numbers(work, WORK_beta);
    const double lever[3] = {C[0] - O[0], C[1] - O[1], C[2] - O[2]};
    memset(A, 0, 36 * sizeof(double));
    for (int i = 0; i < 3; i++) {
        memcpy(A[i], axes + 3 * i, 3 * sizeof(double));
        memcpy(A[3 + i] + 3, axes + 9 + 3 * i, 3 * sizeof(double));
        cross(lever, A[3 + i] + 3, A[3 + i]);
    }
    for (int64_t k = 0; k < whole(work, WORK_locked); k++, v += 6)
        for (int j = 0; j < 6; j++) {
            double sum = 0.0;
            for (int i = 0; i < 6; i++) sum += v[i] * A[i][j];
            for (int i = 0; i < 6; i++) A[i][j] -= beta[k] * v[i] * sum;
        }
}

/* x of M x = x by elimination with pivots; M is overwritten. */
static void solve(int n, double M[6][6], double x[6]) {
    for (int k = 0; k < n; k++) {
        int p = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(M[i][k]) > fabs(M[p][k])) p = i;
        for (int j = 0; j < n; j++) {
            double swapped = M[k][j];
            M[k][j] = M[p][j];
            M[p][j] = swapped;
        }
        double swapped = x[k];
        x[k] = x[p];
        x[p] = swapped;
        for (int i = 0; i < n; i++) {
            if (i == k) continue;
            double share = M[i][k] / M[k][k];
            for (int j = k; j < n; j++) M[i][j] -= share * M[k][j];
            x[i] -= share * x[k];
        }
    }
    for (int k = 0; k < n; k++) x[k] /= M[k][k];
}

/* Unit wrenches W at O, and the motions U with Ω̄ = Σ W Uᵀ. */
static int unit_vectors(const osc_selection *s, double W[6][6], double U[6][6]) {
    int count = s->forces + s->couples;
    memset(W, 0, 36 * sizeof(double));
    memset(U, 0, 36 * sizeof(double));
    for (int k = 0; k < count; k++) {
        int couple = k >= s->forces;
        memcpy(W[k] + 3 * couple, s->axes[k], 3 * sizeof(double));
        memcpy(U[k] + 3 * couple, s->axes[k], 3 * sizeof(double));
        if (couple) cross(s->point, s->axes[k], U[k]);
        else cross(s->point, s->axes[k], W[k] + 3);
    }
    return count;
}

/* Acceleration of the object, in turned energy coordinates. */
static void accelerate(unsigned char *work, int count, double A[6][6], double W[6][6], double U[6][6]) {
    int m = (int)whole(work, WORK_locked);
    const double *a = numbers(work, WORK_a_u), *sigma = numbers(work, WORK_sigma);
    double *x = numbers(work, WORK_acceleration_t);
    double y[6], turned[6][6], M[6][6], lift[6];
    memcpy(y, a, sizeof y);
    for (int k = 0; k < count; k++) {
        double along = product(W[k], a, 6);
        for (int i = 0; i < 6; i++) y[i] -= U[k][i] * along;
    }
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) M[i][j] = A[j][i];
    solve(6, M, y);
    for (int k = 0; k < count; k++)
        for (int i = 0; i < 6; i++) turned[k][i] = product(A[i], W[k], 6);
    for (int i = 0; i < m; i++) y[i] -= sigma[i];
    for (int k = 0; k < count; k++) {
        for (int l = 0; l < count; l++) M[k][l] = product(turned[k] + m, turned[l] + m, 6 - m);
        lift[k] = product(turned[k], y, m);
    }
    solve(count, M, lift);
    for (int i = 0; i < 6; i++) {
        x[i] = i < m ? sigma[i] : y[i];
        for (int k = 0; k < count && i >= m; k++) x[i] += turned[k][i] * lift[k];
    }
}

static void command_selected(osc_controller *c, const void *selection) {
    unsigned char *work = c->work;
    double A[6][6], M[6][6], W[6][6], U[6][6], f[6] = {0.0}, wrench[6];
    const double *N_t = numbers(work, WORK_N_t), *alpha = numbers(work, WORK_alpha_u);
    int count = unit_vectors(selection, W, U);
    wrench_map(work, A);
    accelerate(work, count, A, W, U);
    for (int64_t k = 0; k < whole(work, WORK_rank); k++)
        for (int i = 0; i < 6; i++) f[i] += alpha[k] * N_t[6 * k + i];
    memcpy(M, A, sizeof M);
    solve(6, M, f); /* N α_u at O */
    memcpy(wrench, numbers(c->memory, MEMORY_f_bias), sizeof wrench);
    for (int k = 0; k < count; k++) {
        double selected = product(U[k], f, 6);
        for (int i = 0; i < 6; i++) wrench[i] += W[k][i] * selected;
    }
    memset(numbers(work, WORK_f_S), 0, 6 * sizeof(double)); /* along locked axes none */
    for (int i = (int)whole(work, WORK_locked); i < 6; i++)
        numbers(work, WORK_f_S)[i] = numbers(work, WORK_chain_bias)[i] + product(A[i], wrench, 6) +
                                     product(numbers(work, WORK_Lambda) + 6 * i, numbers(work, WORK_acceleration_t), 6);
}

void osc_select(osc_controller *c, const osc_selection *selection) {
    c->structure = selection != NULL ? command_selected : NULL;
    c->of_structure = selection;
}
