"""The simplest physical plants of the recordings that logs.toml here lists, with parameters at rough values."""


class Heater:
    """A heated block and its sensor, duty Q of 255, temperature T in K: tau T' = gain Q - (T - ambient)."""

    states = ("T",)
    inputs = ("Q",)
    units = {"T": "K", "Q": "1/255"}
    parameters = {"tau": 150.0, "gain": 0.4, "ambient": 300.0, "target": 330.0, "strength": 2.0}
    box = {"T": (300.0, 345.0)}
    guess = (330.0,)

    def f(x, u, t, p, M):
        return [(p.gain * u.Q - (x.T - p.ambient)) / p.tau]

    def kappa(x, t, p, M):
        return [(p.target - p.ambient - p.strength * (x.T - p.target)) / p.gain]

    def V(x, t, p, M):
        return (x.T - p.target) ** 2


class HeaterFahrenheit(Heater):
    """The same, another board, T in °F."""

    units = {"T": "°F", "Q": "1/255"}
    parameters = {"tau": 150.0, "gain": 0.25, "ambient": 74.0, "target": 110.0, "strength": 2.0}
    box = {"T": (74.0, 130.0)}
    guess = (110.0,)


class HeaterSensor:
    """The block B and a sensor T that lags behind it: the rival of `Heater` with a dead time; T is measured."""

    states = ("T", "B")
    inputs = ("Q",)
    units = {"T": "K", "B": "K", "Q": "1/255"}
    parameters = {"tau": 150.0, "lag": 15.0, "gain": 0.4, "ambient": 300.0, "target": 330.0, "strength": 1.0}
    box = {"T": (300.0, 345.0), "B": (300.0, 345.0)}
    guess = (330.0, 330.0)

    def f(x, u, t, p, M):
        return [(x.B - x.T) / p.lag, (p.gain * u.Q - (x.B - p.ambient)) / p.tau]

    def kappa(x, t, p, M):
        return [(p.target - p.ambient - p.strength * (x.B - p.target)) / p.gain]


class Buck:
    """A buck converter's output filter: voltage v, its rate r in V/ms; v falls as the control voltage u rises."""

    states = ("v", "r")
    inputs = ("u",)
    units = {"v": "V", "r": "V/ms", "u": "V"}
    time_unit = "ms"
    parameters = {"w": 4.0, "zeta": 0.6, "gain": -8.0, "v0": 13.0, "u0": 2.35, "strength": 0.05}
    box = {"v": (11.5, 16.0), "r": (-5.0, 5.0)}
    guess = (13.0, 0.0)

    def f(x, u, t, p, M):
        return [x.r, p.w**2 * (p.v0 + p.gain * (u.u - p.u0) - x.v) - 2 * p.zeta * p.w * x.r]

    def kappa(x, t, p, M):
        return [p.u0 + p.strength * (x.v - p.v0)]


class House:
    """A house: heater power Ph, outdoor temperature Ta, indoor Ti; one capacity. C Ti' = Ph + (Ta - Ti) / R."""

    states = ("Ti",)
    inputs = ("Ph", "Ta")
    units = {"Ti": "degC", "Ph": "kW", "Ta": "degC"}
    time_unit = "h"
    parameters = {"R": 0.5, "C": 30.0, "target": 18.0, "strength": 0.1}
    box = {"Ti": (14.0, 22.0)}
    guess = (18.0,)

    def f(x, u, t, p, M):
        return [(u.Ph + (u.Ta - x.Ti) / p.R) / p.C]

    def kappa(x, t, p, M):
        return [(p.target - 5.0) / p.R - p.strength * p.C * (x.Ti - p.target), 5.0]


class Arm:
    """A flexible robot arm, one mode: reaction torque u, acceleration y. One unit of time is one sample."""

    states = ("x", "v")
    inputs = ("u",)
    outputs = ("y",)
    parameters = {"w2": 0.3, "c": 0.05, "k": 0.1, "strength": 1.0}
    box = {"x": (-5.0, 5.0), "v": (-5.0, 5.0)}

    def output(x, t, p, M):
        return [-p.w2 * x.x - p.c * x.v]

    def f(x, u, t, p, M):
        return [x.v, p.k * u.u - p.w2 * x.x - p.c * x.v]

    def kappa(x, t, p, M):
        return [-p.strength * x.v]


class BallBeam:
    """A ball on a beam: angle a of the beam, position r of the ball. r'' = g (a + a0) - d r'."""

    states = ("r", "v")
    inputs = ("a",)
    outputs = ("y",)
    parameters = {"g": 5.0, "d": 0.1, "a0": 0.0, "strength": 1.0}
    box = {"r": (-0.1, 0.1), "v": (-0.1, 0.1)}

    def output(x, t, p, M):
        return [x.r]

    def f(x, u, t, p, M):
        return [x.v, p.g * (u.a + p.a0) - p.d * x.v]

    def kappa(x, t, p, M):
        return [-p.strength * (p.strength * x.r + 2 * x.v) / p.g - p.a0]


class Glass:
    """A glass furnace: heating q1, cooling q2 and q3, one temperature T, all scaled; one unit of time is one sample."""

    states = ("T",)
    inputs = ("q1", "q2", "q3")
    parameters = {"a": 0.05, "b1": 0.01, "b2": 0.01, "b3": 0.01, "strength": 1.0}
    box = {"T": (-3.0, 3.0)}

    def f(x, u, t, p, M):
        return [-p.a * x.T + p.b1 * u.q1 + p.b2 * u.q2 + p.b3 * u.q3]

    def kappa(x, t, p, M):
        return [-p.strength * x.T, 0.0, 0.0]


class HeaterCelsius(Heater):
    """A heater of a board, duty Q in %, temperature T in degC."""

    units = {"T": "degC", "Q": "%"}
    parameters = {"tau": 150.0, "gain": 0.6, "ambient": 21.0, "target": 40.0, "strength": 2.0}
    box = {"T": (20.0, 60.0)}
    guess = (40.0,)
    input_bounds = ((0.0, 100.0),)


class SmallBoard(HeaterCelsius):
    """The single-board heater system: a thin plate of steel with a heater coil, and a fan at constant speed."""

    parameters = {"tau": 40.0, "gain": 0.2, "ambient": 26.0, "target": 32.0, "strength": 2.0}
    box = {"T": (22.0, 45.0)}
    guess = (30.0,)


class TwoHeaters:
    """Two heaters side by side: each warms its own sensor, and they exchange heat. Times in s."""

    states = ("T1", "T2")
    inputs = ("Q1", "Q2")
    units = {"T1": "degC", "T2": "degC", "Q1": "%", "Q2": "%"}
    parameters = {"tau": 150.0, "share": 0.3, "gain1": 0.6, "gain2": 0.3, "ambient": 21.0, "strength": 1.0}
    box = {"T1": (20.0, 60.0), "T2": (20.0, 60.0)}
    guess = (30.0, 30.0)
    input_bounds = ((0.0, 100.0), (0.0, 100.0))

    def f(x, u, t, p, M):
        flow = p.share * (x.T2 - x.T1)
        return [
            (p.gain1 * u.Q1 - (x.T1 - p.ambient) + flow) / p.tau,
            (p.gain2 * u.Q2 - (x.T2 - p.ambient) - flow) / p.tau,
        ]

    def kappa(x, t, p, M):
        return [
            (40.0 - p.ambient - p.strength * (x.T1 - 40.0)) / p.gain1,
            (35.0 - p.ambient - p.strength * (x.T2 - 35.0)) / p.gain2,
        ]


class Servo:
    """A hobby servo: the angle y follows the commanded angle a with a lag."""

    states = ("y",)
    inputs = ("a",)
    parameters = {"K": 1.0, "tau": 0.05, "b": 0.0, "strength": 1.0}
    box = {"y": (-0.7, 0.7)}

    def f(x, u, t, p, M):
        return [(p.K * u.a + p.b - x.y) / p.tau]

    def kappa(x, t, p, M):
        return [-(p.strength * x.y + p.b) / p.K]


class ServoSpring:
    """A hobby servo of second order: a spring towards the command, and friction."""

    states = ("y", "v")
    inputs = ("a",)
    outputs = ("angle",)
    parameters = {"kp": 400.0, "kd": 30.0, "K": 1.0, "strength": 0.5}
    box = {"y": (-0.7, 0.7), "v": (-10.0, 10.0)}

    def output(x, t, p, M):
        return [x.y]

    def f(x, u, t, p, M):
        return [x.v, p.kp * (p.K * u.a - x.y) - p.kd * x.v]

    def kappa(x, t, p, M):
        return [-p.strength * x.y / p.K]


class Silverbox:
    """An electronic Duffing oscillator: voltage u in, voltage y out; its spring hardens by k3."""

    states = ("y", "v")
    inputs = ("u",)
    outputs = ("V2",)
    parameters = {"w": 430.0, "z": 20.0, "g": 180000.0, "k3": 700000.0, "strength": 0.0001}
    box = {"y": (-0.3, 0.3), "v": (-100.0, 100.0)}

    def output(x, t, p, M):
        return [x.y]

    def f(x, u, t, p, M):
        return [x.v, p.g * u.u - p.z * x.v - p.w**2 * x.y - p.k3 * x.y**3]

    def kappa(x, t, p, M):
        return [-p.strength * x.v]


class Tanks:
    """Two tanks, one above the other: pump voltage u, level of the lower one y. Equal outlets are not assumed."""

    states = ("x1", "x2")
    inputs = ("u",)
    outputs = ("y",)
    parameters = {"k2": 0.05, "k3": 0.05, "k4": 0.05, "strength": 0.1}
    box = {"x1": (0.5, 10.0), "x2": (0.5, 10.0)}
    guess = (5.0, 5.0)

    def output(x, t, p, M):
        return [x.x2]

    def f(x, u, t, p, M):
        s1, s2 = M.sqrt(M.maximum(x.x1, 1e-3)), M.sqrt(M.maximum(x.x2, 1e-3))
        return [-p.k2 * s1 + p.k4 * u.u, p.k2 * s1 - p.k3 * s2]

    def kappa(x, t, p, M):
        return [p.k3 * 2.2 / p.k4 - p.strength * (x.x2 - 5.0)]


class TwoTanks(Tanks):
    """The same, another pair, of which both levels are measured."""

    states = ("x1", "x2")
    outputs = ("y1", "y2")
    parameters = {"k2": 0.1, "k3": 0.1, "k4": 0.2, "strength": 0.1}

    def output(x, t, p, M):
        return [x.x1, x.x2]


class Exchanger:
    """A heat exchanger steam-water: flow q of the liquid, its outlet temperature th."""

    states = ("th",)
    inputs = ("q",)
    parameters = {"K": -10.0, "tau": 20.0, "T0": 100.0, "strength": 1.0}
    box = {"th": (90.0, 105.0)}
    guess = (97.0,)
    input_bounds = ((0.0, 1.0),)

    def f(x, u, t, p, M):
        return [(p.K * u.q + p.T0 - x.th) / p.tau]

    def kappa(x, t, p, M):
        return [(97.0 - p.T0 - p.strength * (x.th - 97.0)) / p.K]


class Wheel:
    """A wheel: duty u of 255, speed w in rpm; w0 stands for the dead band."""

    states = ("w",)
    inputs = ("u",)
    units = {"w": "rpm", "u": "1/255"}
    parameters = {"K": 4.0, "tau": 0.1, "w0": 0.0, "strength": 1.0}
    box = {"w": (0.0, 400.0)}
    guess = (100.0,)

    def f(x, u, t, p, M):
        return [(p.K * u.u + p.w0 - x.w) / p.tau]

    def kappa(x, t, p, M):
        return [(200.0 - p.w0 - p.strength * (x.w - 200.0)) / p.K]


class WheelAngle:
    """A wheel: duty u, angle th in counts of its encoder. th'' = (K u - th') / tau."""

    states = ("th", "w")
    inputs = ("u",)
    outputs = ("count",)
    parameters = {"K": 50.0, "tau": 0.1, "strength": 1.0}
    box = {"th": (0.0, 10000.0), "w": (-3000.0, 3000.0)}

    def output(x, t, p, M):
        return [x.th]

    def f(x, u, t, p, M):
        return [x.w, (p.K * u.u - x.w) / p.tau]

    def kappa(x, t, p, M):
        return [-p.strength * (x.th - 2000.0) / p.K]


class Motor:
    """Two coupled motors HSM150: torque M in Nm, speed w in rad/s; M0 is Coulomb friction. J w' = M + M0 - B w."""

    states = ("w",)
    inputs = ("M",)
    parameters = {"J": 1e-3, "B": 1e-3, "M0": 0.0, "strength": 1.0}
    box = {"w": (-300.0, 300.0)}

    def f(x, u, t, p, M):
        return [(u.M + p.M0 - p.B * x.w) / p.J]

    def kappa(x, t, p, M):
        return [p.B * 100.0 - p.M0 - p.strength * p.B * (x.w - 100.0)]


class Gyro:
    """A gyroscope fixed to a motor's axis: its rate follows the motor's speed with a lag."""

    states = ("av",)
    inputs = ("mv",)
    parameters = {"K": 1.0, "tau": 0.01, "b": 0.0, "strength": 1.0}
    box = {"av": (-100.0, 100.0)}

    def f(x, u, t, p, M):
        return [(p.K * u.mv + p.b - x.av) / p.tau]

    def kappa(x, t, p, M):
        return [-(p.strength * x.av + p.b) / p.K]


class Propeller:
    """A brushless motor with its controller: pulse u in us, speed w in rpm."""

    states = ("w",)
    inputs = ("u",)
    units = {"w": "rpm", "u": "us"}
    parameters = {"K": 0.1, "tau": 0.1, "u0": 1500.0, "strength": 1.0}
    box = {"w": (-100.0, 100.0)}

    def f(x, u, t, p, M):
        return [(p.K * (u.u - p.u0) - x.w) / p.tau]

    def kappa(x, t, p, M):
        return [p.u0 - p.strength * x.w / p.K]


class Roll:
    """A multicopter: roll rate r by the mixer's roll command u."""

    states = ("r",)
    inputs = ("u",)
    units = {"r": "rad/s"}
    parameters = {"g": 100.0, "d": 2.0, "b": 0.0, "strength": 0.05}
    box = {"r": (-3.0, 3.0)}

    def f(x, u, t, p, M):
        return [p.g * (u.u + p.b) - p.d * x.r]

    def kappa(x, t, p, M):
        return [-p.strength * x.r - p.b]


class HairDryer:
    """A tube with a fan (Feedback PT326): heater voltage u, thermocouple y downstream, both in V."""

    states = ("y",)
    inputs = ("u",)
    parameters = {"K": 0.9, "tau": 0.4, "y0": 0.0, "strength": 1.0}
    box = {"y": (3.0, 7.0)}
    guess = (5.0,)

    def f(x, u, t, p, M):
        return [(p.K * u.u + p.y0 - x.y) / p.tau]

    def kappa(x, t, p, M):
        return [(5.0 - p.y0 - p.strength * (x.y - 5.0)) / p.K]


class Lamp:
    """A halogen lamp heats a thin plate: voltage u, temperature T in degC behind the plate."""

    states = ("T",)
    inputs = ("u",)
    parameters = {"K": 15.0, "tau": 50.0, "T0": 40.0, "strength": 1.0}
    box = {"T": (70.0, 200.0)}
    guess = (130.0,)

    def f(x, u, t, p, M):
        return [(p.K * u.u + p.T0 - x.T) / p.tau]

    def kappa(x, t, p, M):
        return [(130.0 - p.T0 - p.strength * (x.T - 130.0)) / p.K]


class GasFurnace:
    """A gas furnace: methane feed u in cubic feet per min, CO2 y in % at the outlet."""

    states = ("y",)
    inputs = ("u",)
    parameters = {"K": -2.0, "tau": 20.0, "y0": 53.5, "strength": 1.0}
    box = {"y": (45.0, 61.0)}
    guess = (53.5,)

    def f(x, u, t, p, M):
        return [(p.K * u.u + p.y0 - x.y) / p.tau]

    def kappa(x, t, p, M):
        return [(53.5 - p.y0 - p.strength * (x.y - 53.5)) / p.K]


class Drive:
    """Two electric motors coupled by a flexible belt: the sensor gives the pulley's speed without its sign."""

    states = ("w", "a")
    inputs = ("u",)
    outputs = ("z",)
    parameters = {"w2": 30.0, "c": 3.0, "k": 60.0, "strength": 0.1}
    box = {"w": (-4.0, 4.0), "a": (-40.0, 40.0)}
    guess = (0.5, 0.0)

    def output(x, t, p, M):
        return [M.sqrt(x.w**2 + 1e-4)]

    def f(x, u, t, p, M):
        return [x.a, p.k * u.u - p.w2 * x.w - p.c * x.a]

    def kappa(x, t, p, M):
        return [p.w2 / p.k - p.strength * (x.w - 1.0)]


class Crane:
    """A hydraulic crane: valve u, oil pressure y, both scaled; one unit of time is one sample."""

    states = ("x", "v")
    inputs = ("u",)
    outputs = ("y",)
    parameters = {"w2": 0.1, "c": 0.1, "k": 0.1, "b": 0.0, "strength": 0.1}
    box = {"x": (-4.0, 4.0), "v": (-4.0, 4.0)}

    def output(x, t, p, M):
        return [x.x]

    def f(x, u, t, p, M):
        return [x.v, p.k * u.u + p.b - p.w2 * x.x - p.c * x.v]

    def kappa(x, t, p, M):
        return [-p.strength * x.v]


class Wing:
    """A wing in flutter, one mode: excitation u, response y; one unit of time is one sample."""

    states = ("x", "v")
    inputs = ("u",)
    outputs = ("y",)
    parameters = {"w2": 0.2, "c": 0.05, "k": 0.1, "strength": 0.1}
    box = {"x": (-4.0, 4.0), "v": (-4.0, 4.0)}

    def output(x, t, p, M):
        return [x.x]

    def f(x, u, t, p, M):
        return [x.v, p.k * u.u - p.w2 * x.x - p.c * x.v]

    def kappa(x, t, p, M):
        return [-p.strength * x.v]
