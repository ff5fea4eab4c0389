/* The steps of a network's program, on arrays of REAL, which is float or double. Calls have literal sizes and strides, so
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
#define WIDTH (BYTES / (int)sizeof(REAL)) /* numbers in a vector */

static INLINED Vector loaded(const REAL *a)
{
    return *(const Vector *)a;
}

/* out (rows, vectors) += a (rows, terms) b (terms, vectors), in sums that stay in registers: rows x vectors of them, of
 * which about eight do not wait for each other. */
static INLINED void tile(int rows, int vectors, int terms, REAL *restrict out, ptrdiff_t to, const REAL *restrict a,
                         View of, const REAL *restrict b, ptrdiff_t by)
{
    Vector sums[4][4];
UNROLLED
    for (int i = 0; i < rows; i++) {
UNROLLED
        for (int v = 0; v < vectors; v++) {
            sums[i][v] = loaded(out + i * to + v * WIDTH);
        }
    }
    for (int k = 0; k < terms; k++) {
UNROLLED
        for (int v = 0; v < vectors; v++) {
            const Vector each = loaded(b + k * by + v * WIDTH);
UNROLLED
            for (int i = 0; i < rows; i++) {
                sums[i][v] += a[i * of.row + k * of.column] * each;
            }
        }
    }
UNROLLED
    for (int i = 0; i < rows; i++) {
UNROLLED
        for (int v = 0; v < vectors; v++) {
            *(Vector *)(out + i * to + v * WIDTH) = sums[i][v];
        }
    }
}

/* The rows of a tile of so many vectors, from column j on. */
static INLINED void strip(int rows, int vectors, int terms, REAL *restrict out, ptrdiff_t to, const REAL *restrict a,
                          View of, const REAL *restrict b, ptrdiff_t by)
{
    int i = 0;
    for (; i + 4 <= rows && vectors <= 2; i += 4) {
        tile(4, vectors, terms, out + i * to, to, a + i * of.row, of, b, by);
    }
    for (; i + 2 <= rows; i += 2) {
        tile(2, vectors, terms, out + i * to, to, a + i * of.row, of, b, by);
    }
    for (; i < rows; i++) {
        tile(1, vectors, terms, out + i * to, to, a + i * of.row, of, b, by);
    }
}

/* out (rows, n) = start + a (rows, terms) b (terms, n), where start is out itself if it `adds`, else bias, else 0. */
static INLINED void product(int rows, int terms, int n, REAL *restrict out, View to,
                                                          const REAL *restrict a, View of, const REAL *restrict b,
                                                          View by, const REAL *restrict bias, View from, int adds)
{
    const int tiled = by.column == 1 && to.column == 1 ? n - n % (2 * WIDTH) : 0; /* columns */
    const int wide = rows < 4 ? tiled - tiled % (4 * WIDTH) : 0;
    for (int i = 0; i < rows && !adds; i++) {
        for (int j = 0; j < n; j++) {
            out[i * to.row + j * to.column] = bias ? bias[i * from.row + j * from.column] : 0;
        }
    }
    for (int j = 0; j < wide; j += 4 * WIDTH) {
        strip(rows, 4, terms, out + j, to.row, a, of, b + j, by.row);
    }
    for (int j = wide; j < tiled; j += 2 * WIDTH) {
        strip(rows, 2, terms, out + j, to.row, a, of, b + j, by.row);
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
