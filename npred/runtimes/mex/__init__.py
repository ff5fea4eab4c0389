"""The gateway that makes a controller's C a function of MATLAB and GNU Octave, a MEX file."""

from importlib import resources

from npred.loop.controller import Controller


def source(controller: Controller, name: str = "npred", precision: str = "double") -> str:
    """The text of NAME_mex.c, for the C that npred.runtimes.c_controller.sources gives with this name and precision."""
    guarded = "(double)controller->part[0]" if controller.predictor.guard is not None else "((void)controller, none)"
    lines = [
        f'#include "{name}.h"',
        f"#define CORE(function) {name}_##function",
        f"#define CONTROLLER {name}_controller",
        f"#define SAVED {name}_saved",
        f"#define REAL {precision}",
        f"#define MEASURED {int(controller.actuator == 'measured')}",
        f"#define GUARDED(part, none) {guarded}",
        *(f"#define {size} {name.upper()}_{size}" for size in ("N_STATES", "M_INPUTS", "NX")),
    ]
    gateway = resources.files(__name__).joinpath("gateway.c").read_text(encoding="utf-8")
    return gateway.replace("NAME", name).replace('#include "mex.h"\n', '#include "mex.h"\n' + "\n".join(lines) + "\n")
