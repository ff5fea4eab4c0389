/* A program with nothing but a controller: its sizes are the controller's. */
#include "npred.h"

static npred_controller controller;
volatile npred_real measured[NPRED_N_STATES + NPRED_NX * NPRED_M_INPUTS], commanded[NPRED_M_INPUTS];

int main(void)
{
    npred_init(&controller);
    for (;;) {
        (void)npred_step(&controller, (const npred_real *)measured, MEASURED_FROM (npred_real *)commanded);
    }
}

extern unsigned stack_top[];
void reset(void);
void reset(void)
{
    (void)main();
}

__attribute__((section(".vectors"), used)) static const void *const vectors[] = {stack_top, (const void *)reset};
