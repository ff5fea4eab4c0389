"""Planar chains of rigid links, hanging, a motor at each joint: plants that track, and whose f is costly."""

from npred.formulas.ldl import total


def arm(links: int) -> type:
    """The declaration of a chain of so many equal rods.

    States are the links' angles to the vertical, downwards, theta1, theta2, … (rad), and their rates omega1, … (rad/s);
    inputs the joints' torques tau1, … (N m). Lagrange's equations in absolute angles:
        sum_j c_ij cos(theta_i - theta_j) omega_j' + sum_j c_ij sin(theta_i - theta_j) omega_j² + g d_i sin(theta_i)
            = tau_i - tau_i+1 - friction omega_i,
    with c_ij the coupling of rods i and j, d_i the first moment that hangs on rod i. The law is computed torque about
        r_i(t) = i pose + amplitude sin(frequency t + i),
    with friction compensated at the rate that the error calls for, r' - damping e / 2, not at the measured one: to
    cancel what is stable turns an error of the prediction into a torque as large as friction is. So the errors e of the
    angles obey M (e'' + damping e' + stiffness e) = -friction (e' + damping e / 2).
    """
    angles = tuple(f"theta{i + 1}" for i in range(links))
    rates = tuple(f"omega{i + 1}" for i in range(links))
    inputs = tuple(f"tau{i + 1}" for i in range(links))

    def f(x, u, t, p, M):
        torques = [*u, 0.0]
        inertia, loads = _mechanics(x, p, M, links)
        drag = [p.friction * rate for rate in x[links:]]
        return [*x[links:], *M.solve(inertia, [torques[i] - torques[i + 1] - loads[i] - drag[i] for i in range(links)])]

    def mechanics(x, u, t, p, M):
        torques = [*u, 0.0]
        inertia, loads = _mechanics(x, p, M, links)
        return inertia, [torques[i] - torques[i + 1] - loads[i] for i in range(links)], [p.friction] * links

    def kappa(x, t, p, M):
        goal, speed, pulls = _motion(t, p, M, links)
        errors = [x[i] - goal[i] for i in range(links)]
        for i in range(links):
            pulls[i] = pulls[i] - p.stiffness * errors[i] - p.damping * (x[links + i] - speed[i])
        inertia, loads = _mechanics(x, p, M, links)
        drag = [p.friction * (speed[i] - 0.5 * p.damping * errors[i]) for i in range(links)]
        forces = [
            loads[i] + drag[i] + total(a * b for a, b in zip(inertia[i], pulls, strict=True)) for i in range(links)
        ]
        return [total(forces[i:]) for i in range(links)]

    def V(x, t, p, M):
        return total((a - b) * (a - b) for a, b in zip(x, reference(t, p, M), strict=True))

    def reference(t, p, M):
        goal, speed, _ = _motion(t, p, M, links)
        return goal + speed

    return type(f"PlanarArm{links}", (), {
        "__doc__": f"A planar chain of {links} links that tracks by computed torque; see arm.",
        "states": angles + rates,
        "inputs": inputs,
        "units": dict.fromkeys(angles, "rad") | dict.fromkeys(rates, "rad/s") | dict.fromkeys(inputs, "N m"),
        "parameters": {"mass": 1.0, "length": 0.5, "gravity": 9.81, "friction": 0.1, "stiffness": 4.0, "damping": 4.0,
                       "pose": 0.3, "amplitude": 0.1, "frequency": 1.0},
        "box": {name: (0.3 * i, 0.3 * i + 0.6) for i, name in enumerate(angles)} | dict.fromkeys(rates, (-0.3, 0.3)),
        "f": staticmethod(f), "mechanics": staticmethod(mechanics),
        "kappa": staticmethod(kappa), "V": staticmethod(V), "reference": staticmethod(reference),
    })  # fmt: skip


def _motion(t, p, M, links: int):
    """The desired angles, rates and accelerations."""
    turns = [p.frequency * t + (i + 1.0) for i in range(links)]
    waves = [p.amplitude * M.sin(turn) for turn in turns]
    goal = [(i + 1) * p.pose + wave for i, wave in enumerate(waves)]
    speed = [p.amplitude * p.frequency * M.cos(turn) for turn in turns]
    return goal, speed, [-(p.frequency * p.frequency * wave) for wave in waves]


def _mechanics(x, p, M, links: int):
    """The mass matrix c_ij cos(theta_i - theta_j), by sines and cosines, and the loads: centrifugal forces, weight."""
    s, c = [M.sin(x[i]) for i in range(links)], [M.cos(x[i]) for i in range(links)]
    squares, moment, spin = [rate * rate for rate in x[links:]], p.mass * p.length, p.mass * p.length * p.length
    # c_ij: what rod max(i, j) and those beyond it add, and a rod's own inertia, m l² / 3 about its end
    inertia = [[spin * (links - 1 - i + 1 / 3)] * links for i in range(links)]
    loads = [moment * p.gravity * (links - 0.5 - i) * s[i] for i in range(links)]
    for i in range(links):
        for j in range(i):
            coupling = spin * (links - 1 - i + 0.5)
            inertia[i][j] = inertia[j][i] = coupling * (c[i] * c[j] + s[i] * s[j])
            across = coupling * (s[i] * c[j] - c[i] * s[j])
            loads[i], loads[j] = loads[i] + across * squares[j], loads[j] - across * squares[i]
    return inertia, loads


PLANTS = {f"planar_arm{links}": arm(links) for links in range(2, 8)}
