/* PREDICT by a network: its inputs scaled into z, v and r, the STEPS of its program to N_ (N, NODES), and P = start + gain
 * N_, by cubics between the nodes where these are fewer than NX. The
 * arrays are members of the memory `q`; npred.networks.program says what they are. */
static INLINED void PART(_scaled)(int lanes, const double *X, const double *u, double D_hat, double t,
                                 PART(_memory) *restrict q)
{
    for (int c = 0; c < N; c++) {
        q->z[c] = (REAL)((asinh(X[c * lanes] * c_X_bend[c]) - c_X_zero[c]) * c_X_gain[c]);
    }
    if (PHASED) {
        const double turns = t / PERIOD, angle = 2.0 * 3.141592653589793 * (turns - floor(turns));
        q->z[N] = (REAL)cos(angle);
        q->z[N + 1] = (REAL)sin(angle);
    }
    q->z[SEEN] = (REAL)((D_hat - c_D_hat_zero[0]) * c_D_hat_gain[0]);
    for (int c = 0; c < M; c++) {
        double total = 0.0;
        for (int j = 0; j < NX; j++) {
            q->v[j * M + c] = (REAL)((u[(j * M + c) * lanes] - c_u_zero[c]) * c_u_gain[c]);
        }
        /* The running mean is summed in double precision, four nodes at a time: that of equal values is exact. */
        for (int j = 0; j < NX - NX % 4; j += 4) {
            const double q0 = q->v[j * M + c], q1 = q->v[(j + 1) * M + c], q2 = q->v[(j + 2) * M + c];
            const double q3 = q->v[(j + 3) * M + c], q01 = q0 + q1;
            q->prefix[j] = total + q0;
            q->prefix[j + 1] = total + q01;
            q->prefix[j + 2] = total + (q01 + q2);
            total += q01 + (q2 + q3);
            q->prefix[j + 3] = total;
        }
        for (int j = NX - NX % 4; j < NX; j++) {
            total += q->v[j * M + c];
            q->prefix[j] = total;
        }
        q->r[c * NX] = q->v[c];
        for (int j = 1; j < NX; j++) {
            q->r[c * NX + j] = (REAL)((2.0 * q->prefix[j] - q->v[c] - q->v[j * M + c]) * c_halves[j]);
        }
    }
    if (PAIRED) { /* row 0: the difference of the sample from the plant at rest; row 1: the plant at rest */
        for (int c = 0; c < COLUMNS; c++) {
            q->z[COLUMNS + c] = c < N ? 0 : q->z[c];
            q->z[c] = c < N ? q->z[c] : 0;
        }
    }
}

/* N_ of the sample less that of the plant at rest. */
static INLINED void PART(_network)(int lanes, const double *X, const double *u, double D_hat, double t,
                                  PART(_memory) *restrict q)
{
#if SERIES_TERMS || TWICE
#if SERIES_TERMS
    const double s = (D_hat - SERIES_LOW) * SERIES_SCALE - 1.0;
    const int inside = fabs(s) <= 1.0;
#else
    const int inside = 0;
#endif
    for (int row = inside ? 1 : 0; row < 2; row++) { /* outside the series the point of rest has a pass of its own */
        PART(_scaled)(lanes, X, u, D_hat, t, q);
        for (int c = 0; c < N && row == 0; c++) {
            q->z[c] = 0;
        }
        for (int k = 0; k < NX * M && row == 0; k++) {
            q->r[k] = 0;
        }
        PART(_operations)(q);
        for (int k = 0; k < N * NODES && row == 0; k++) {
            q->N_rest[k] = q->N_[k];
        }
    }
#if SERIES_TERMS
    if (inside) {
        double one = 1.0, two = s;
        for (int k = 0; k < SERIES_TERMS; k++) {
            const double next = 2.0 * s * two - one;
            q->T[k] = (REAL)one;
            one = two;
            two = next;
        }
        PART(_series)(q);
    }
#endif
    for (int k = 0; k < N * NODES; k++) {
        q->N_[k] -= q->N_rest[k];
    }
#else
    PART(_scaled)(lanes, X, u, D_hat, t, q);
    PART(_operations)(q);
#endif
#if STRIDE > 1
    refine(N, NODES, STRIDE, q->N_, c_refine, q->N_fine);
#endif
}

/* P of lane l. */
static INLINED void PART(_lane)(int lanes, const double *X, const double *u, double D_hat, double t,
                                PART(_memory) *restrict q, double *P)
{
#if STRIDE > 1
    const REAL *const v = q->N_fine;
#else
    const REAL *const v = q->N_;
#endif
    PART(_network)(lanes, X, u, D_hat, t, q);
    for (int j = 0; j < NX; j++) {
        for (int c = 0; c < N; c++) {
#if BASED
            const double start = c_base[c], factor = 1.0;
#else
            const double start = X[c * lanes], factor = D_hat;
#endif
            P[((ptrdiff_t)j * N + c) * lanes] = start + factor * (double)(c_gain[c * NX + j] * v[c * NX + j]);
        }
    }
}

static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    PART(_memory) *const q = (PART(_memory) *)(((uintptr_t)work + BYTES - 1) / BYTES * BYTES);
    (void)p;
    if (d.lanes == 1) { /* with strides that are known */
        PART(_lane)(1, X, u, D_hat[0], t, q, P);
        return;
    }
    for (int l = 0; l < d.lanes; l++) {
        PART(_lane)(d.lanes, X + l, u + l, D_hat[l], t, q, P + l);
    }
}
