/* The steps of a network's program, on arrays of REAL, which is float or double. Calls have literal sizes and strides, so
 * that a compiler unrolls and vectorises each by itself. */
#define BOTH(in_float, in_double) (sizeof(REAL) == sizeof(float) ? (in_float) : (in_double))

typedef struct {
    ptrdiff_t row, column; /* element (i, k) of a view of memory v is v[i row + k column] */
} View;

/* Rows i … i + 3 and terms k … k + 7 of a product: each b that is loaded serves all four. */
static INLINED void four_rows(int n, int terms, REAL *restrict out, View to,
                                                            const REAL *restrict a, View of, const REAL *restrict b,
                                                            View by)
{
    const ptrdiff_t s = of.column;
    const REAL *const a0 = a, *const a1 = a + of.row, *const a2 = a + 2 * of.row, *const a3 = a + 3 * of.row;
    if (terms == 8) {
        LANES for (int j = 0; j < n; j++) {
            const REAL *v = b + j * by.column;
            const REAL b0 = v[0], b1 = v[by.row], b2 = v[2 * by.row], b3 = v[3 * by.row];
            const REAL b4 = v[4 * by.row], b5 = v[5 * by.row], b6 = v[6 * by.row], b7 = v[7 * by.row];
            REAL *y = out + j * to.column;
            y[0] += ((a0[0] * b0 + a0[s] * b1) + (a0[2 * s] * b2 + a0[3 * s] * b3)) +
                    ((a0[4 * s] * b4 + a0[5 * s] * b5) + (a0[6 * s] * b6 + a0[7 * s] * b7));
            y[to.row] += ((a1[0] * b0 + a1[s] * b1) + (a1[2 * s] * b2 + a1[3 * s] * b3)) +
                         ((a1[4 * s] * b4 + a1[5 * s] * b5) + (a1[6 * s] * b6 + a1[7 * s] * b7));
            y[2 * to.row] += ((a2[0] * b0 + a2[s] * b1) + (a2[2 * s] * b2 + a2[3 * s] * b3)) +
                             ((a2[4 * s] * b4 + a2[5 * s] * b5) + (a2[6 * s] * b6 + a2[7 * s] * b7));
            y[3 * to.row] += ((a3[0] * b0 + a3[s] * b1) + (a3[2 * s] * b2 + a3[3 * s] * b3)) +
                             ((a3[4 * s] * b4 + a3[5 * s] * b5) + (a3[6 * s] * b6 + a3[7 * s] * b7));
        }
        return;
    }
    for (int k = 0; k < terms; k++) {
        const REAL c0 = a0[k * s], c1 = a1[k * s], c2 = a2[k * s], c3 = a3[k * s];
        LANES for (int j = 0; j < n; j++) {
            const REAL v = b[k * by.row + j * by.column];
            REAL *y = out + j * to.column;
            y[0] += c0 * v;
            y[to.row] += c1 * v;
            y[2 * to.row] += c2 * v;
            y[3 * to.row] += c3 * v;
        }
    }
}

static INLINED void one_row(int n, int terms, REAL *restrict out, View to,
                                                          const REAL *restrict a, View of, const REAL *restrict b,
                                                          View by)
{
    const ptrdiff_t s = of.column;
    if (terms == 8) {
        LANES for (int j = 0; j < n; j++) {
            const REAL *v = b + j * by.column;
            out[j * to.column] += ((a[0] * v[0] + a[s] * v[by.row]) + (a[2 * s] * v[2 * by.row] + a[3 * s] * v[3 * by.row])) +
                                  ((a[4 * s] * v[4 * by.row] + a[5 * s] * v[5 * by.row]) +
                                   (a[6 * s] * v[6 * by.row] + a[7 * s] * v[7 * by.row]));
        }
        return;
    }
    for (int k = 0; k < terms; k++) {
        LANES for (int j = 0; j < n; j++) {
            out[j * to.column] += a[k * s] * b[k * by.row + j * by.column];
        }
    }
}

/* out (rows, n) = start + a (rows, terms) b (terms, n), where start is out itself if it `adds`, else bias, else 0. */
static INLINED void product(int rows, int terms, int n, REAL *restrict out, View to,
                                                          const REAL *restrict a, View of, const REAL *restrict b,
                                                          View by, const REAL *restrict bias, View from, int adds)
{
    for (int i = 0; i < rows && !adds; i++) {
        for (int j = 0; j < n; j++) {
            out[i * to.row + j * to.column] = bias ? bias[i * from.row + j * from.column] : 0;
        }
    }
    for (int i = 0; i < rows - rows % 4; i += 4) {
        int k = 0;
        for (; k + 8 <= terms; k += 8) {
            four_rows(n, 8, out + i * to.row, to, a + i * of.row + k * of.column, of, b + k * by.row, by);
        }
        four_rows(n, terms % 8, out + i * to.row, to, a + i * of.row + k * of.column, of, b + k * by.row, by);
    }
    for (int i = rows - rows % 4; i < rows; i++) {
        int k = 0;
        for (; k + 8 <= terms; k += 8) {
            one_row(n, 8, out + i * to.row, to, a + i * of.row + k * of.column, of, b + k * by.row, by);
        }
        one_row(n, terms % 8, out + i * to.row, to, a + i * of.row + k * of.column, of, b + k * by.row, by);
    }
}

/* 1 + e^-x: 2^k by the exponent's bits, and 2^f on [-1/2, 1/2] to rounding. */
static inline REAL one_plus_exp(REAL x)
{
    static const REAL terms[] = EXP2;
    const int count = (int)(sizeof terms / sizeof *terms);
    REAL y = x * (REAL)-1.4426950408889634, f, value;
    y = y > (REAL)(1 - EXPONENT) ? y : (REAL)(1 - EXPONENT); /* NaN too: as an integer it is undefined */
    y = y < (REAL)(EXPONENT - 1) ? y : (REAL)(EXPONENT - 1);
    const int32_t k = (int32_t)(y + (REAL)(EXPONENT + 0.5));
    union {
        INTEGER bits;
        REAL number;
    } power = {(INTEGER)k << MANTISSA};
    f = y - (REAL)(k - EXPONENT);
    value = terms[count - 1];
UNROLLED
    for (int i = count - 2; i >= 0; i--) {
        value = terms[i] + f * value;
    }
    return (REAL)1 + power.number * value;
}

/* e^d - 1 on [-1/2, 1/2]. */
static inline REAL change_of_exp(REAL d)
{
    static const REAL terms[] = EXPM1;
    const int count = (int)(sizeof terms / sizeof *terms);
    REAL value = terms[count - 1];
UNROLLED
    for (int i = count - 2; i >= 0; i--) {
        value = terms[i] + d * value;
    }
    return d * value;
}

static inline void silu(int count, const REAL *a, REAL *out)
{
    LANES for (int j = 0; j < count; j++) {
        out[j] = a[j] / one_plus_exp(a[j]);
    }
}

/* Of rows (difference, rest): silu(rest + difference) - silu(rest), and silu(rest). With s the logistic function and
 * d = b - a: silu(b) - silu(a) = d s(b) + a (s(b) - s(a)), and for small d s(b) - s(a) = s(a) (1 - s(b)) (e^d - 1), which
 * cancels nothing. */
static inline void silu_pair(int count, const REAL *a, REAL *out)
{
    LANES for (int j = 0; j < count; j++) {
        const REAL d = a[j], rest = a[count + j];
        const REAL s_rest = 1 / one_plus_exp(rest), s = 1 / one_plus_exp(rest + d);
        const REAL small = s_rest * (1 - s) * change_of_exp(d), size = d < 0 ? -d : d;
        out[count + j] = rest * s_rest;
        out[j] = d * s + rest * (size < (REAL)0.5 ? small : s - s_rest);
    }
}

/* out (columns, rows) = a (rows, columns). */
static inline void transpose(int rows, int columns, const REAL *a, View of, REAL *out, View to)
{
    for (int j = 0; j < columns; j++) {
        for (int i = 0; i < rows; i++) {
            out[j * to.row + i * to.column] = a[i * of.row + j * of.column];
        }
    }
}

/* out (rows, nx) of its even and odd parts about the middle, given on the first half. */
static inline void mirror(int rows, int nx, const REAL *even, View of_even, const REAL *odd, View of_odd, REAL *out,
                          View to)
{
    for (int i = 0; i < rows; i++) {
        for (int j = 0; j < (nx + 1) / 2; j++) {
            out[i * to.row + (nx - 1 - j) * to.column] =
                even[i * of_even.row + j * of_even.column] - odd[i * of_odd.row + j * of_odd.column];
        }
        for (int j = 0; j < (nx + 1) / 2; j++) {
            out[i * to.row + j * to.column] =
                even[i * of_even.row + j * of_even.column] + odd[i * of_odd.row + j * of_odd.column];
        }
    }
}
