/* What all kernels share. Arrays have their lanes innermost: element (j, c) of lane l of an array with `size`
 * components is a[(j * size + c) * lanes + l]. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifndef INDEX
#define INDEX int64_t /* numbers of control steps */
#endif

typedef struct {
    int nx;    /* nodes of x in [0, 1] */
    int lanes; /* loops side by side */
    int rows;  /* control steps that the history of commands holds */
    int n, m;  /* states, inputs */
} Shape;

#ifndef WIDE
#define WIDE 64 /* lanes of a block, whose scratch memory is on the stack */
#define LANES _Pragma("GCC ivdep") /* a loop over lanes, which do not know of each other */
#endif
#if WIDE > 1
#define GROUP 8 /* lanes that go side by side from one call of a plant's function to the next */
#define CALLED(function, count, q, y) ((count) == 1 ? function##_one(q, y) : function##_group(q, y))
#else
#define GROUP 1
#define CALLED(function, count, q, y) function##_one(q, y)
#endif
#define JOINED(a, b) a##b
#define JOIN(a, b) JOINED(a, b)
#define PART(suffix) JOIN(KERNEL, suffix)
#ifdef __GNUC__
#define INLINED inline __attribute__((always_inline))
#define APART __attribute__((noinline))
#define ALIASED __attribute__((may_alias)) /* scratch memory of other numbers */
#define UNROLLED _Pragma("GCC unroll 16")
#define SPARE __attribute__((unused)) /* a function that some kernels do not call */
#else
#define INLINED inline
#define APART
#define ALIASED
#define UNROLLED
#define SPARE
#endif

SPARE static inline double larger(double a, double b)
{
    return a < b ? b : a;
}

SPARE static inline double smaller(double a, double b)
{
    return b < a ? b : a;
}

SPARE static inline double sign_of(double a)
{
    return (double)((a > 0.0) - (a < 0.0));
}

/* a modulo b with the sign of b, as Python's % and NumPy's mod. */
SPARE static inline double modulus(double a, double b)
{
    const double rest = fmod(a, b);
    return rest != 0.0 && (rest < 0.0) != (b < 0.0) ? rest + b : rest;
}

/* A table at x: each of its rows is where a piece begins and the coefficients of a polynomial in the distance from
 * there. The first piece comes before the table, the last after it: both are level. */
SPARE static inline double interpolated(double x, int count, int width, const double *rows)
{
    const double *last = rows + (count - 1) * width;
    const double inside = smaller(larger(x, rows[0]), last[0]);
    int low = 0, high = count;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        const int before = x < rows[middle * width];
        high = before ? middle : high;
        low = before ? low : middle;
    }
    const double *row = rows + low * width;
    const double s = inside - row[0];
    double value = row[width - 1] + 0.0 * s;
    for (int k = width - 2; k > 0; k--) {
        value = value * s + row[k];
    }
    return value;
}

SPARE static inline int least(int a, int b)
{
    return b < a ? b : a;
}

SPARE static inline int most(int a, int b)
{
    return a < b ? b : a;
}

/* i modulo a positive number, never negative. */
SPARE static inline int modulo(INDEX i, int count)
{
    const int rest = (int)(i % count);
    return rest < 0 ? rest + count : rest;
}

/* sin(x + quarters pi / 2) without a branch, so that loops over lanes become vector instructions, as they do not where
 * they call the library. x less its quarter turns, by pi / 2 in three parts (Cody, Waite, Software Manual for the
 * Elementary Functions, ch. 8), then the polynomials of fdlibm (k_sin.c, k_cos.c): two units in the last place at most,
 * and from |x| = 1e6 on without FMA, of the last place of x. Within [-1, 1] for any finite x; NaN of an infinite one. */
SPARE static INLINED double turned(double x, double quarters)
{
    const double k = rint(x * 0.63661977236758134), q = k + quarters, quadrant = q - 4.0 * floor(0.25 * q);
    const double near = ((x - k * 1.57079632673412561417) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
    const double r = smaller(larger(near, -1.0), 1.0), z = r * r, half = 0.5 * z, w = 1.0 - half;
    const double s5 = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10;
    const double s3 = -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * s5);
    const double s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * s3));
    const double c5 = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11;
    const double c3 = 2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * c5);
    const double c1 = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * c3);
    const double c = w + (((1.0 - w) - half) + z * z * c1);
    const double value = quadrant == 1.0 || quadrant == 3.0 ? c : s;
    return quadrant < 2.0 ? value : -value;
}

SPARE static INLINED double sine(double x)
{
    return turned(x, 0.0);
}

SPARE static INLINED double cosine(double x)
{
    return turned(x, 1.0);
}
