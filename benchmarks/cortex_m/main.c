/*
 * Runs the steps of a controller's own test and writes each U, on a Cortex-M through semihosting or on the host.
 * On the Cortex-M also: SysTick's ticks, and how deep the stack went, over all steps.
 */
#define NPRED_TEST
#define main own_test
#include "npred.c"
#undef main

static void write_text(const char *text);

static void write_number(uint32_t number)
{
    char text[12];
    int at = 11;
    text[at] = 0;
    do {
        text[--at] = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    write_text(&text[at]);
    write_text(" ");
}

/* U as a signed number of 1e-9 of its size. */
static void write_scaled(double value)
{
    if (value < 0) {
        write_text("-");
    }
    write_number((uint32_t)(fabs(value) * 1e9 + 0.5));
}

static npred_controller controller;

static int run_steps(void)
{
    npred_init(&controller);
    for (int s = 0; s < TEST_CALLS; s++) {
        npred_real U[NPRED_M_INPUTS];
        const int code = test_call(&controller, s, U);
        if ((code != NPRED_OK) != isnan(test_U[s * NPRED_M_INPUTS])) {
            return 1;
        }
        for (int i = 0; i < NPRED_M_INPUTS && code == NPRED_OK; i++) {
            write_scaled((double)U[i] / (double)test_size[i]);
        }
    }
    write_text("\n");
    return 0;
}

#ifdef __arm__

#define SYSTICK ((volatile uint32_t *)0xE000E010u) /* control, reload, value */
#define PATTERN 0xDEADBEEFu

extern uint32_t stack_bottom[], stack_top[];

static void semihost(uint32_t call, const void *argument)
{
    register uint32_t r0 __asm__("r0") = call;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

static void write_text(const char *text)
{
    semihost(4, text);
}

static void measure_steps(void)
{
    uint32_t ticks = 0, *here = (uint32_t *)__builtin_frame_address(0) - 64;
    npred_init(&controller);
    for (uint32_t *word = stack_bottom; word < here; word++) {
        *word = PATTERN;
    }
    SYSTICK[1] = 0xFFFFFFu;
    SYSTICK[2] = 0;
    SYSTICK[0] = 5; /* on, at the processor's clock */
    for (int s = 0; s < TEST_CALLS; s++) {
        npred_real U[NPRED_M_INPUTS];
        const uint32_t before = SYSTICK[2];
        (void)test_call(&controller, s, U);
        ticks += (before - SYSTICK[2]) & 0xFFFFFFu;
    }
    const uint32_t *deepest = stack_bottom;
    while (*deepest == PATTERN) {
        deepest++;
    }
    write_number(TEST_CALLS);
    write_number(ticks);
    write_number((uint32_t)((const char *)__builtin_frame_address(0) - (const char *)deepest));
    write_text("\n");
}

int main(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n isb");
    if (run_steps() == 0) {
        measure_steps();
    }
    semihost(0x18, (const void *)0x20026);
    for (;;) {
    }
}

void reset(void);
void reset(void)
{
    (void)main();
}

__attribute__((section(".vectors"), used)) static const void *const vectors[] = {stack_top, (const void *)reset};

#else

#include <stdio.h>

static void write_text(const char *text)
{
    fputs(text, stdout);
}

int main(void)
{
    return run_steps();
}

#endif
