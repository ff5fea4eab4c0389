/*
#include "about.h"
 *
 * C99. It needs only libm and allocates nothing. Its memory is static, so make one call at a time.
 * Compiled with -DNPRED_TEST it is a program that compares its results with those of the trained model.
 */
#include "sizes.h"

/* Predict P from the state X, the commands under way u and D_hat. u[j * M_INPUTS + c] is input c at the node
 * x = j / (NX - 1); P[j * N_STATES + c] is state c there. t is the time now. */
#if PHASED
void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat, double t, double P[SIZE_P]);
#else
void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat, double P[SIZE_P]);
#endif

#if ONE_DELAY
/* The control law U = kappa(X, t), without bounds. X is the last row of P, and t is now + D_hat, when U arrives. */
void npred_control(const double X[N_STATES], double t, double U[M_INPUTS]);
#else
/* The control law U_j = kappa_j(P(r_j), t + r_j D_hat), without bounds. The delay of input j is r_j times the longest;
 * P is cubic between nodes; t is the time now. */
void npred_control(const double P[SIZE_P], double D_hat, double t, double U[M_INPUTS]);
#endif

#define WIDE 1 /* lane */
#define LANES
#define INDEX int
#include "kernels.h"

#if PHASED
void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat, double t, double P[SIZE_P])
#else
void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat, double P[SIZE_P])
#endif
{
    static Memory memory;
    const Shape shape = {NX, 1, 0, N_STATES, M_INPUTS};
#if PHASED
    NETWORK(shape, X, u, &D_hat, t, parameters, P, (double *)&memory);
#else
    NETWORK(shape, X, u, &D_hat, 0, parameters, P, (double *)&memory);
#endif
}

#if ONE_DELAY
void npred_control(const double X[N_STATES], double t, double U[M_INPUTS])
{
    npred_law(X, t, parameters, U);
}
#else
void npred_control(const double P[SIZE_P], double D_hat, double t, double U[M_INPUTS])
{
    npred_law(P, D_hat, t, parameters, U);
}
#endif

#ifdef NPRED_TEST
#include <stdio.h>

#include "test.h"

int main(void)
{
    static double P[SIZE_P];
    double U[M_INPUTS], worst = 0;
    for (int s = 0; s < SAMPLES; s++) {
#if PHASED
        npred_predict(test_X + s * N_STATES, test_u + s * SIZE_U, test_D_hat[s], test_t[s], P);
#else
        npred_predict(test_X + s * N_STATES, test_u + s * SIZE_U, test_D_hat[s], P);
#endif
#if ONE_DELAY
        npred_control(P + (NX - 1) * N_STATES, test_t[s] + test_D_hat[s], U);
#else
        npred_control(P, test_D_hat[s], test_t[s], U);
#endif
        for (int k = 0; k < SIZE_P; k++) {
            worst = fmax(worst, fabs(P[k] - test_P[s * SIZE_P + k]) / test_size[k % N_STATES]);
        }
        for (int k = 0; k < M_INPUTS; k++) {
            worst = fmax(worst, fabs(U[k] - test_U[s * M_INPUTS + k]) / test_size[N_STATES + k]);
        }
    }
    printf("largest difference: %.2e of each state's size\n", worst);
    return !(worst <= 1e-5);
}
#endif
