/* The operations of a network's program, on arrays of REAL, which is float or double. Calls have literal sizes and strides, so
 * that a compiler unrolls and vectorises each by itself. */
#define BOTH(in_float, in_double) (sizeof(REAL) == sizeof(float) ? (in_float) : (in_double))

typedef struct {
    ptrdiff_t row, column; /* element (i, k) of a view of memory v is v[i row + k column] */
} View;

#if defined __AVX512VBMI2__ /* not on the first processors with vectors of 64 bytes: those slow down for them */
#define BYTES 64
#elif defined __AVX__
#define BYTES 32
#elif defined __SSE2__ || defined __ARM_NEON
#define BYTES 16
#else
#define BYTES (int)sizeof(REAL)
#endif
#if defined __AVX__ || defined __SSE2__ || defined __ARM_NEON
typedef REAL Vector __attribute__((vector_size(BYTES), aligned(sizeof(REAL)), may_alias));
typedef REAL Short __attribute__((vector_size(BYTES < 32 ? BYTES : 32), aligned(sizeof(REAL)), may_alias));
#else
typedef REAL Vector, Short;
#endif
#if defined __AVX512VBMI2__ && !defined __clang__
#define VECTORS_64 __attribute__((target("prefer-vector-width=512")))
#else
#define VECTORS_64
#endif
#ifdef __GNUC__
#define LINED __attribute__((aligned(BYTES))) /* a vector that lies in two lines of the cache is read twice */
#else
#define LINED
#endif
#define LANE (BYTES / (int)sizeof(REAL)) /* columns of a vector */
#define SHORT (int)(sizeof(Short) / sizeof(REAL)) /* of one whose columns are summed */
#define SUMS 16 /* at most, that a tile keeps in registers */

static INLINED Vector loaded(const REAL *a)
{
    return *(const Vector *)a;
}

/* out (rows, vectors LANE) = start + a (rows, terms) b (terms, vectors LANE), `start` being 0 where there is none. Literal
 * sizes make the sums registers; each is split into `chains` that do not wait for each other. */
static INLINED void tile(const int rows, const int vectors, const int chains, int terms, REAL *out, View to, const REAL *a,
                         View of, const REAL *b, ptrdiff_t by, const REAL *start, ptrdiff_t from)
{
    Vector s[SUMS];
    const int size = rows * vectors;
    int k = 0;
UNROLLED
    for (int q = 0; q < chains * size; q++) {
        s[q] = start && q < size ? loaded(start + q / vectors * from + q % vectors * LANE) : (Vector){0};
    }
    for (; k + chains <= terms; k += chains) {
UNROLLED
        for (int c = 0; c < chains; c++) {
UNROLLED
            for (int j = 0; j < vectors; j++) {
                const Vector weight = loaded(b + (k + c) * by + j * LANE);
UNROLLED
                for (int i = 0; i < rows; i++) {
                    s[c * size + i * vectors + j] += a[i * of.row + (k + c) * of.column] * weight;
                }
            }
        }
    }
    for (; k < terms; k++) {
UNROLLED
        for (int q = 0; q < size; q++) {
            s[q] += a[q / vectors * of.row + k * of.column] * loaded(b + k * by + q % vectors * LANE);
        }
    }
UNROLLED
    for (int q = 0; q < size; q++) {
UNROLLED
        for (int c = 1; c < chains; c++) {
            s[q] += s[c * size + q];
        }
        *(Vector *)(out + q / vectors * to.row + q % vectors * LANE) = s[q];
    }
}

/* Tiles of some sizes, each a function of its own: inlined side by side their sums would not stay in registers. */
#define A_TILE(rows, vectors, chains)                                                                                  \
    SPARE static APART void tile_##rows##_##vectors(int terms, REAL *out, View to, const REAL *a, View of,             \
                                                    const REAL *b, ptrdiff_t by, const REAL *start, ptrdiff_t from)    \
    {                                                                                                                  \
        tile(rows, vectors, chains, terms, out, to, a, of, b, by, start, from);                                        \
    }
A_TILE(1, 8, 1)
A_TILE(1, 4, 2)
A_TILE(1, 2, 4)
A_TILE(1, 1, 8)
A_TILE(2, 6, 1)
A_TILE(2, 4, 1)
A_TILE(2, 2, 2)
A_TILE(2, 1, 4)
A_TILE(3, 4, 1)
A_TILE(3, 2, 2)
A_TILE(3, 1, 4)
#ifdef __AVX512VBMI2__
A_TILE(2, 3, 2)
A_TILE(6, 2, 1)
#endif

/* Rows of the columns from j on, as many at a time as there are. */
#define TILE_ROWS(count, vectors)                                                                                      \
    for (; i + (count) <= rows; i += (count)) {                                                                        \
        tile_##count##_##vectors(terms, out + i * to.row + j, to, a + i * of.row, of, weights, stride,                 \
                                 start ? start + i * from.row + j : 0, from.row);                                      \
    }
/* The columns that tiles of so many vectors take, from j on. */
#define TILE_COLUMNS(vectors, EACH)                                                                                    \
    for (; j + (vectors) * LANE <= n; j += (vectors) * LANE) {                                                         \
        const int low = j / panel * panel;                                                                             \
        const ptrdiff_t stride = panel < n ? least(panel, n - low) : by.row;                                           \
        const REAL *const weights = b + (ptrdiff_t)low * terms + (j - low);                                            \
        int i = 0;                                                                                                     \
        EACH                                                                                                           \
    }

/* out (rows, n) = start + a (rows, terms) b (terms, n), where start is out itself if it `adds`, else bias, else 0. The
 * columns of b lie in panels of so many, each of all terms: in the order in which they are read. */
static INLINED void product(int rows, int terms, int n, int panel, REAL *out, View to, const REAL *a, View of, const REAL *b,
                            View by, const REAL *bias, View from, int adds)
{
    const REAL *const start = adds ? out : bias;
    int j = 0;
    from = adds ? to : from;
    if (by.column == 1 && to.column == 1) {
#ifdef __AVX512VBMI2__ /* as many columns, in half as many vectors */
        if (rows == 1) {
            TILE_COLUMNS(4, TILE_ROWS(1, 4))
        } else if (rows == 2) {
            TILE_COLUMNS(3, TILE_ROWS(2, 3))
        }
        TILE_COLUMNS(2, TILE_ROWS(6, 2) TILE_ROWS(3, 2) TILE_ROWS(2, 2) TILE_ROWS(1, 2))
#else
        if (rows == 1) {
            TILE_COLUMNS(8, TILE_ROWS(1, 8))
        } else if (rows == 2) {
            TILE_COLUMNS(6, TILE_ROWS(2, 6))
        }
        TILE_COLUMNS(4, TILE_ROWS(3, 4) TILE_ROWS(2, 4) TILE_ROWS(1, 4))
#endif
        TILE_COLUMNS(2, TILE_ROWS(3, 2) TILE_ROWS(2, 2) TILE_ROWS(1, 2))
        TILE_COLUMNS(1, TILE_ROWS(3, 1) TILE_ROWS(2, 1) TILE_ROWS(1, 1))
    }
    for (int i = 0; i < rows && j < n; i++) {
        for (int c = j; c < n; c++) {
            const int low = c / panel * panel;
            const ptrdiff_t stride = panel < n ? least(panel, n - low) : by.row;
            const REAL *const weights = b + (ptrdiff_t)low * terms + (c - low) * by.column;
            REAL sum = start ? start[i * from.row + c * from.column] : 0;
            for (int k = 0; k < terms; k++) {
                sum += a[i * of.row + k * of.column] * weights[k * stride];
            }
            out[i * to.row + c * to.column] = sum;
        }
    }
}

/* out (rows, n) = bias + a (rows, terms) times the transpose of b (n, terms), for few columns. */
SPARE static INLINED void dots(int rows, int terms, int n, REAL *out, View to, const REAL *a, View of, const REAL *b, View by,
                         const REAL *bias, View from)
{
    const int tiled = terms - terms % SHORT;
    for (int i = 0; i < rows; i++) {
        for (int j = 0; j < n; j++) {
            const REAL *const x = a + i * of.row, *const y = b + j * by.row;
            Short sums = {0}, others = {0};
            REAL sum = bias ? bias[i * from.row + j * from.column] : 0;
            for (int k = 0; k + SHORT < tiled; k += 2 * SHORT) {
                sums += *(const Short *)(x + k) * *(const Short *)(y + k);
                others += *(const Short *)(x + k + SHORT) * *(const Short *)(y + k + SHORT);
            }
            if (tiled % (2 * SHORT)) {
                sums += *(const Short *)(x + tiled - SHORT) * *(const Short *)(y + tiled - SHORT);
            }
            sums += others;
            for (int k = 0; k < SHORT; k++) {
                sum += ((const REAL *)&sums)[k];
            }
            for (int k = tiled; k < terms; k++) {
                sum += x[k] * y[k];
            }
            out[i * to.row + j * to.column] = sum;
        }
    }
}

/* y (2 modes, width) = R v of complex numbers, all Re, then all Im, from `pairs` (2 modes, 2 width): Re v and Im v times
 * (Re R, Im R). */
SPARE static inline void recombine(int modes, int width, const REAL *pairs, REAL *y)
{
    for (int e = 0; e < modes; e++) {
        const REAL *const real = pairs + e * 4 * width, *const imaginary = real + 2 * width;
        REAL *const out = y + e * width;
        LANES for (int j = 0; j < width; j++) {
            out[j] = real[j] - imaginary[width + j];
            out[modes * width + j] = real[width + j] + imaginary[j];
        }
    }
}

/* out (rows, (nodes - 1) stride + 1): the cubic through four of the nodes of a (rows, nodes), by weights (3, 4, stride) in
 * the first cell, in those between, and in the last one. */
SPARE static inline void refine(int rows, int nodes, int stride, const REAL *a, const REAL *weights, REAL *out)
{
    for (int i = 0; i < rows; i++) {
        REAL *y = out + i * ((nodes - 1) * stride + 1);
        for (int cell = 0; cell < nodes - 1; cell++, y += stride) {
            const REAL *const v = a + i * nodes + most(least(cell - 1, nodes - 4), 0);
            const REAL *const w = weights + (cell > 0) * 4 * stride + (cell > 0 && cell == nodes - 2) * 4 * stride;
            LANES for (int j = 0; j < stride; j++) {
                y[j] = v[0] * w[j] + v[1] * w[stride + j] + v[2] * w[2 * stride + j] + v[3] * w[3 * stride + j];
            }
        }
        *y = a[i * nodes + nodes - 1];
    }
}

#define BLOCK 64 /* numbers that an activation takes at a time */

typedef union {
    REAL number;
    INTEGER bits;
} Bits;

/* 1 + e^-x within half of what an exponent holds, also of NaN: the nearest whole number of -x log2(e) by the exponent's
 * bits, and 2^f on [-1/2, 1/2] to rounding. A number plus 1.5 times 2^MANTISSA has its whole part in the last bits. Bounds
 * are compared as bits: the least of signed ones for numbers above 0, of unsigned ones for those below. */
static INLINED REAL one_plus_exp(REAL x)
{
    static const REAL terms[] = EXP2;
    const int count = (int)(sizeof terms / sizeof *terms);
    const REAL scale = (REAL)-1.4426950408889634, large = (REAL)1.5 * (REAL)((INTEGER)1 << MANTISSA) + (REAL)EXPONENT;
    const Bits high = {(REAL)(EXPONENT / 2 * 0.6931471805599453)}, low = {-high.number};
    Bits near = {x}, whole, power;
    REAL f, value = terms[count - 1];
    near.bits = near.bits < high.bits ? near.bits : high.bits;
    near.bits = (UNSIGNED)near.bits < (UNSIGNED)low.bits ? near.bits : low.bits;
    whole.number = near.number * scale + large;
    f = near.number * scale - (whole.number - large);
    power.bits = (INTEGER)((UNSIGNED)whole.bits << MANTISSA);
UNROLLED
    for (int i = count - 2; i >= 0; i--) {
        value = terms[i] + f * value;
    }
    return (REAL)1 + power.number * value;
}

/* y = 1 / (1 + e^-x): a division, the dearest operation, for two of them. */
static INLINED void logistic(int width, const REAL *x, REAL *y)
{
    const int half = width / 2;
    LANES for (int j = 0; j < half; j++) {
        const REAL one = one_plus_exp(x[j]), two = one_plus_exp(x[half + j]), both = 1 / (one * two);
        y[j] = two * both;
        y[half + j] = one * both;
    }
    if (width % 2) {
        y[width - 1] = 1 / one_plus_exp(x[width - 1]);
    }
}

/* e^d - 1 on [-1/2, 1/2]. */
static INLINED REAL change_of_exp(REAL d)
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

SPARE VECTORS_64 static APART void silu(int count, const REAL *a, REAL *out)
{
    REAL s[BLOCK];
    for (int i = 0; i < count; i += BLOCK) {
        const int width = least(BLOCK, count - i);
        logistic(width, a + i, s);
        for (int j = 0; j < width; j++) {
            out[i + j] = a[i + j] * s[j];
        }
    }
}

/* Of rows (difference, rest): silu(rest + difference) - silu(rest), and silu(rest). With s the logistic function and
 * d = b - a: silu(b) - silu(a) = d s(b) + a (s(b) - s(a)), and for small d s(b) - s(a) = s(a) (1 - s(b)) (e^d - 1), which
 * cancels nothing. */
SPARE VECTORS_64 static APART void silu_pair(int count, const REAL *a, REAL *out)
{
    REAL s[BLOCK], sum[BLOCK], s_rest[BLOCK];
    for (int i = 0; i < count; i += BLOCK) {
        const REAL *const d = a + i, *const rest = d + count;
        const int width = least(BLOCK, count - i);
        for (int j = 0; j < width; j++) {
            sum[j] = rest[j] + d[j];
        }
        logistic(width, sum, s);
        logistic(width, rest, s_rest);
        LANES for (int j = 0; j < width; j++) {
            const REAL small = s_rest[j] * (1 - s[j]) * change_of_exp(d[j]), size = d[j] < 0 ? -d[j] : d[j];
            out[count + i + j] = rest[j] * s_rest[j];
            out[i + j] = d[j] * s[j] + rest[j] * (size < (REAL)0.5 ? small : s[j] - s_rest[j]);
        }
    }
}

/* Of the even and the odd parts a (2, count): with v = silu(even + odd), w = silu(even - odd), out is v + w, then v - w. */
SPARE VECTORS_64 static APART void silu_parts(int count, const REAL *a, REAL *out)
{
    REAL x[2 * BLOCK], s[2 * BLOCK];
    for (int i = 0; i < count; i += BLOCK) {
        const int width = least(BLOCK, count - i);
        for (int j = 0; j < width; j++) {
            x[j] = a[i + j] + a[count + i + j];
            x[width + j] = a[i + j] - a[count + i + j];
        }
        logistic(2 * width, x, s);
        LANES for (int j = 0; j < width; j++) {
            const REAL v = x[j] * s[j], w = x[width + j] * s[width + j];
            out[i + j] = v + w;
            out[count + i + j] = v - w;
        }
    }
}

/* The sums and the differences (2 (nx + 1) / 2, width) of rows j and nx - 1 - j of v (nx, width). */
SPARE static inline void parts(int nx, int width, const REAL *v, REAL *out)
{
    for (int j = 0; j < (nx + 1) / 2; j++) {
        const REAL *const a = v + j * width, *const b = v + (nx - 1 - j) * width;
        REAL *const sums = out + j * width, *const differences = sums + (nx + 1) / 2 * width;
        LANES for (int c = 0; c < width; c++) {
            sums[c] = a[c] + b[c];
            differences[c] = a[c] - b[c];
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

/* The even and odd parts (m, width) of v (nx, m) about the middle, on the first half, and zeros behind. */
SPARE static inline void halves(int m, int nx, int width, const REAL *v, REAL *even, REAL *odd)
{
    for (int c = 0; c < m; c++) {
        for (int j = 0; j < nx / 2; j++) {
            const REAL a = v[j * m + c], b = v[(nx - 1 - j) * m + c];
            even[c * width + j] = a + b;
            odd[c * width + j] = a - b;
        }
        for (int j = nx / 2; j < width; j++) {
            even[c * width + j] = 2 * j == nx - 1 ? v[j * m + c] : 0;
            odd[c * width + j] = 0;
        }
    }
}
