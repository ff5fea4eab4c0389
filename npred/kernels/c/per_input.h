/* One delay per input, counted in nodes: EDGES are where the histories of the inputs end, the last of them at nx - 1.
 * A step that an edge lies inside is taken in pieces, so that a method keeps its order where an input jumps. */
static const double PART(_ratios)[M] = RATIOS;

/* Where the history of input c ends; an edge this close to a node is on it. */
static inline double PART(_edge)(int c, int last)
{
    const double position = PART(_ratios)[c] * (double)last, near = rint(position);
    return fabs(position - near) < 1e-9 ? near : position;
}

/* The end of the piece that begins at `begin`: the next edge of an input that comes sooner than the last, or `end`. */
static inline double PART(_until)(double begin, double end, int last)
{
    for (int c = 0; c < M; c++) {
        const double edge = PART(_edge)(c, last);
        end = PART(_ratios)[c] < 1.0 && begin < edge && edge < end ? edge : end;
    }
    return end;
}

/* Input c from one position in nodes to another, as a straight line: the means of its halves, out of the means that the
 * nodes have over the cells around them, less steep where it would leave these. */
static inline void PART(_read)(int c, int last, int lanes, int width, const double *u, double from, double to,
                               double *begin, double *half, double *end)
{
    const double middle = 0.5 * (from + smaller(to, (double)last)), length = 2.0 * (middle - from);
    const int first = least((int)(from + 0.5), last), stop = least((int)ceil(from + length - 0.5), last);
    const double *v = u + ((ptrdiff_t)first * M + c) * lanes;
    double low[WIDE], high[WIDE];
    if (width < 1) { /* which no call has, and a compiler does not know */
        return;
    }
    LANES for (int l = 0; l < width; l++) {
        low[l] = high[l] = v[l];
        begin[l] = end[l] = length > 0.0 ? 0.0 : v[l]; /* past its end kappa acts */
    }
    for (int k = first; length > 0.0 && k <= stop; k++, v += (ptrdiff_t)M * lanes) {
        const double a = larger((double)k - 0.5, from), b = smaller((double)k + 0.5, from + length);
        const double left = 2.0 * larger(smaller(b, middle) - a, 0.0) / length;
        const double right = 2.0 * larger(b - larger(a, middle), 0.0) / length;
        LANES for (int l = 0; l < width; l++) {
            low[l] = smaller(low[l], v[l]);
            high[l] = larger(high[l], v[l]);
            begin[l] += left * v[l];
            end[l] += right * v[l];
        }
    }
    LANES for (int l = 0; l < width; l++) {
        const double mean = 0.5 * (begin[l] + end[l]), room = smaller(mean - low[l], high[l] - mean);
        const double slope = larger(smaller(end[l] - begin[l], room), -room);
        begin[l] = mean - slope;
        half[l] = mean;
        end[l] = mean + slope;
    }
}

/* x a piece further, in place; past[c] says that the history of input c has ended there, and kappa acts. */
static inline void PART(_piece)(double begin, double end, int last, int lanes, int width, const double *u,
                                const double *D_hat, double t, const double *p, int stride, double *x)
{
    double a[M * WIDE], half[M * WIDE], b[M * WIDE], past[M];
    for (int c = 0; c < M; c++) {
        const double r = PART(_ratios)[c];
        past[c] = r < 1.0 && begin >= PART(_edge)(c, last);
        const double from = past[c] > 0.0 ? (double)last : begin / r, to = past[c] > 0.0 ? (double)last : end / r;
        PART(_read)(c, last, lanes, width, u, from, to, a + c * WIDE, half + c * WIDE, b + c * WIDE);
    }
    LANES for (int l = 0; l < width; l++) {
        const double h = D_hat[l] * (end - begin) / (double)last, now = t + D_hat[l] * begin / (double)last;
        STEP(stride, WIDE, 1, x + l, a + l, half + l, b + l, past, now, h, p, x + l);
    }
}

#ifdef LAW
/* CONTROL: U_c = kappa_c at the prediction and the time where its history ends; LAW reads all these states. */
static inline void KERNEL(Shape d, const double *P, const double *u, const double *D_hat, double t, const double *p, double *U,
                   double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    double Y[M * N * WIDE];
    (void)work;
    for (int from = 0; from < lanes; from += WIDE) {
        const int width = least(WIDE, lanes - from);
        for (int c = 0; c < M; c++) {
            const double edge = PART(_edge)(c, last);
            const double *x = P + (ptrdiff_t)(int)edge * N * lanes + from;
            double *y = Y + c * N * WIDE;
            for (int k = 0; k < N; k++) {
                for (int l = 0; l < width; l++) {
                    y[k * WIDE + l] = x[k * lanes + l];
                }
            }
            for (double begin = floor(edge), end; begin < edge; begin = end) {
                end = PART(_until)(begin, edge, last);
                PART(_piece)(begin, end, last, lanes, width, u + from, D_hat + from, t, p, WIDE, y);
            }
        }
        for (int l = 0; l < width; l++) {
            LAW(WIDE, lanes, Y + l, t, D_hat[from + l], p, U + from + l);
        }
    }
}
#else
/* PREDICT */
static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    const ptrdiff_t row = (ptrdiff_t)N * lanes;
    (void)work;
    for (ptrdiff_t k = 0; k < row; k++) {
        P[k] = X[k];
    }
    for (int j = 0; j < last; j++) {
        for (ptrdiff_t k = 0; k < row; k++) {
            P[(j + 1) * row + k] = P[j * row + k];
        }
        for (int from = 0; from < lanes; from += WIDE) {
            const int width = least(WIDE, lanes - from);
            for (double begin = (double)j, end; begin < (double)j + 1.0; begin = end) {
                end = PART(_until)(begin, (double)j + 1.0, last);
                PART(_piece)(begin, end, last, lanes, width, u + from, D_hat + from, t, p, lanes,
                             P + (j + 1) * row + from);
            }
        }
    }
}
#endif
