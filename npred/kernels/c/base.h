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
