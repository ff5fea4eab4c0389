/* The operations of a network's program, on arrays of REAL, which is float or double. Calls have literal sizes and strides, so
 * that a compiler unrolls and vectorises each by itself. */
#define BOTH(in_float, in_double) (sizeof(REAL) == sizeof(float) ? (in_float) : (in_double))

typedef struct {
    ptrdiff_t row, column; /* element (i, k) of a view of memory v is v[i row + k column] */
} View;

#if defined __AVX__
#define BYTES 32
#elif defined __SSE2__ || defined __ARM_NEON
#define BYTES 16
#else
#define BYTES (int)sizeof(REAL)
#endif
#if defined __AVX__ || defined __SSE2__ || defined __ARM_NEON
typedef REAL Vector __attribute__((vector_size(BYTES), aligned(sizeof(REAL)), may_alias));
#else
typedef REAL Vector;
#endif
#define TILE (2 * BYTES / (int)sizeof(REAL)) /* columns of a product whose sums stay in registers */

static INLINED Vector loaded(const REAL *a)
{
    return *(const Vector *)a;
}

/* out (4, TILE) += a (4, terms) b (terms, TILE). */
static INLINED void four_rows(int terms, REAL *restrict out, ptrdiff_t to, const REAL *restrict a, View of,
                              const REAL *restrict b, ptrdiff_t by)
{
    REAL *const y1 = out + to, *const y2 = y1 + to, *const y3 = y2 + to;
    Vector s00 = loaded(out), s01 = loaded(out + TILE / 2), s10 = loaded(y1), s11 = loaded(y1 + TILE / 2);
    Vector s20 = loaded(y2), s21 = loaded(y2 + TILE / 2), s30 = loaded(y3), s31 = loaded(y3 + TILE / 2);
    for (int k = 0; k < terms; k++) {
        const Vector b0 = loaded(b + k * by), b1 = loaded(b + k * by + TILE / 2);
        const REAL *const x = a + k * of.column;
        s00 += x[0] * b0;
        s01 += x[0] * b1;
        s10 += x[of.row] * b0;
        s11 += x[of.row] * b1;
        s20 += x[2 * of.row] * b0;
        s21 += x[2 * of.row] * b1;
        s30 += x[3 * of.row] * b0;
        s31 += x[3 * of.row] * b1;
    }
    *(Vector *)out = s00;
    *(Vector *)(out + TILE / 2) = s01;
    *(Vector *)y1 = s10;
    *(Vector *)(y1 + TILE / 2) = s11;
    *(Vector *)y2 = s20;
    *(Vector *)(y2 + TILE / 2) = s21;
    *(Vector *)y3 = s30;
    *(Vector *)(y3 + TILE / 2) = s31;
}

/* out (2, TILE) += a (2, terms) b (terms, TILE). */
static INLINED void two_rows(int terms, REAL *restrict out, ptrdiff_t to, const REAL *restrict a, View of,
                             const REAL *restrict b, ptrdiff_t by)
{
    REAL *const y = out + to;
    Vector s00 = loaded(out), s01 = loaded(out + TILE / 2), s10 = loaded(y), s11 = loaded(y + TILE / 2);
    for (int k = 0; k < terms; k++) {
        const Vector b0 = loaded(b + k * by), b1 = loaded(b + k * by + TILE / 2);
        const REAL *const x = a + k * of.column;
        s00 += x[0] * b0;
        s01 += x[0] * b1;
        s10 += x[of.row] * b0;
        s11 += x[of.row] * b1;
    }
    *(Vector *)out = s00;
    *(Vector *)(out + TILE / 2) = s01;
    *(Vector *)y = s10;
    *(Vector *)(y + TILE / 2) = s11;
}

/* out (TILE) += a (terms) b (terms, TILE), in two chains of sums that do not wait for each other. */
static INLINED void one_row(int terms, REAL *restrict out, const REAL *restrict a, View of, const REAL *restrict b,
                            ptrdiff_t by)
{
    static const REAL zeros[TILE] = {0};
    Vector s00 = loaded(out), s01 = loaded(out + TILE / 2), s10 = loaded(zeros), s11 = s10;
    int k = 0;
    for (; k + 2 <= terms; k += 2) {
        const REAL x0 = a[k * of.column], x1 = a[(k + 1) * of.column];
        s00 += x0 * loaded(b + k * by);
        s01 += x0 * loaded(b + k * by + TILE / 2);
        s10 += x1 * loaded(b + (k + 1) * by);
        s11 += x1 * loaded(b + (k + 1) * by + TILE / 2);
    }
    if (k < terms) {
        s00 += a[k * of.column] * loaded(b + k * by);
        s01 += a[k * of.column] * loaded(b + k * by + TILE / 2);
    }
    *(Vector *)out = s00 + s10;
    *(Vector *)(out + TILE / 2) = s01 + s11;
}

/* out (rows, n) = start + a (rows, terms) b (terms, n), where start is out itself if it `adds`, else bias, else 0. */
static INLINED void product(int rows, int terms, int n, REAL *restrict out, View to,
                                                          const REAL *restrict a, View of, const REAL *restrict b,
                                                          View by, const REAL *restrict bias, View from, int adds)
{
    const int tiled = by.column == 1 && to.column == 1 ? n - n % TILE : 0; /* columns */
    for (int i = 0; i < rows && !adds; i++) {
        for (int j = 0; j < n; j++) {
            out[i * to.row + j * to.column] = bias ? bias[i * from.row + j * from.column] : 0;
        }
    }
    for (int j = 0; j < tiled; j += TILE) {
        int i = 0;
        for (; i + 4 <= rows; i += 4) {
            four_rows(terms, out + i * to.row + j, to.row, a + i * of.row, of, b + j, by.row);
        }
        for (; i + 2 <= rows; i += 2) {
            two_rows(terms, out + i * to.row + j, to.row, a + i * of.row, of, b + j, by.row);
        }
        for (; i < rows; i++) {
            one_row(terms, out + i * to.row + j, a + i * of.row, of, b + j, by.row);
        }
    }
    for (int i = 0; i < rows && tiled < n; i++) {
        for (int k = 0; k < terms; k++) {
            const REAL x = a[i * of.row + k * of.column];
            LANES for (int j = tiled; j < n; j++) {
                out[i * to.row + j * to.column] += x * b[k * by.row + j * by.column];
            }
        }
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

SPARE static inline void silu(int count, const REAL *a, REAL *out)
{
    LANES for (int j = 0; j < count; j++) {
        out[j] = a[j] / one_plus_exp(a[j]);
    }
}

/* Of rows (difference, rest): silu(rest + difference) - silu(rest), and silu(rest). With s the logistic function and
 * d = b - a: silu(b) - silu(a) = d s(b) + a (s(b) - s(a)), and for small d s(b) - s(a) = s(a) (1 - s(b)) (e^d - 1), which
 * cancels nothing. */
SPARE static inline void silu_pair(int count, const REAL *a, REAL *out)
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
SPARE static inline void transpose(int rows, int columns, const REAL *a, View of, REAL *out, View to)
{
    for (int j = 0; j < columns; j++) {
        for (int i = 0; i < rows; i++) {
            out[j * to.row + i * to.column] = a[i * of.row + j * of.column];
        }
    }
}

/* out (rows, nx) of its even and odd parts about the middle, given on the first half. */
SPARE static inline void mirror(int rows, int nx, const REAL *even, View of_even, const REAL *odd, View of_odd,
                                REAL *out, View to)
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
