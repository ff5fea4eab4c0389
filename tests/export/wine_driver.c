/* Steps the FMU of a DLL, FMI 3.0, by numbers from stdin: the DLL, its token, dt, the references and values of the inputs
   and of the output, then the inputs of each step. It prints the output of each. */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

#define MOST 4096
typedef int Set(void *, const uint32_t *, size_t, const double *, size_t);
typedef int Get(void *, const uint32_t *, size_t, double *, size_t);
typedef void *Instantiate(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t,
                          void *, void (*)(void *, int, const char *, const char *), void *);
typedef int Enter(void *, bool, double, double, bool, double);
typedef int Exit(void *);
typedef int DoStep(void *, double, double, bool, bool *, bool *, bool *, double *);

struct block { size_t references, values; uint32_t reference[MOST]; double value[MOST]; };
static struct block in, out;
static HMODULE library;

static void *named(const char *name)
{
    void *function = (void *)GetProcAddress(library, name);
    if (!function) { fprintf(stderr, "no %s\n", name); exit(2); }
    return function;
}

static void check(const char *what, int status)
{
    if (status) { fprintf(stderr, "%s: status %d\n", what, status); exit(3); }
}

static void said(void *environment, int status, const char *category, const char *text)
{
    (void)environment; (void)status; (void)category;
    fprintf(stderr, "%s\n", text);
}

static void described(struct block *block)
{
    if (scanf("%zu", &block->references) != 1) exit(4);
    for (size_t i = 0; i < block->references; i++) if (scanf("%u", &block->reference[i]) != 1) exit(4);
    if (scanf("%zu", &block->values) != 1 || block->values > MOST) exit(4);
}

int main(void)
{
    char path[MOST], token[MOST];
    double dt, reached;
    size_t steps;
    bool event, end, early;
    if (scanf("%4095s %4095s %lf %zu", path, token, &dt, &steps) != 4) return 4;
    described(&in);
    described(&out);
    library = LoadLibraryA(path);
    if (!library) { fprintf(stderr, "no library %s: %lu\n", path, GetLastError()); return 2; }
    void *one = ((Instantiate *)named("fmi3InstantiateCoSimulation"))(
        "one", token, NULL, false, true, false, false, NULL, 0, NULL, said, NULL);
    if (!one) return 3;
    check("enter", ((Enter *)named("fmi3EnterInitializationMode"))(one, false, 0, 0, false, 0));
    check("exit", ((Exit *)named("fmi3ExitInitializationMode"))(one));
    Set *set = (Set *)named("fmi3SetFloat64");
    Get *get = (Get *)named("fmi3GetFloat64");
    DoStep *step = (DoStep *)named("fmi3DoStep");
    double t = 0;
    for (size_t k = 0; k < steps; k++, t += dt) {
        for (size_t i = 0; i < in.values; i++) if (scanf("%lf", &in.value[i]) != 1) return 4;
        check("set", set(one, in.reference, in.references, in.value, in.values));
        check("step", step(one, t, dt, true, &event, &end, &early, &reached));
        check("get", get(one, out.reference, out.references, out.value, out.values));
        for (size_t i = 0; i < out.values; i++) printf("%.17g\n", out.value[i]);
    }
    return 0;
}
