"""The simplest physical plants of the recordings that logs.toml here lists, with parameters at rough values."""

from typing import Any


def plant(
    name: str, states: str, inputs: str, f: Any, kappa: Any, parameters: dict[str, float], *box: Any, **parts: Any
) -> type:  # fmt: skip
    """A plant's class, of the words that a user writes."""
    names, output = tuple(states.split()), parts.get("output")
    if isinstance(output, str):  # the state that is measured
        parts["output"] = lambda x, t, p, M: [getattr(x, output)]
    own = {"states": names, "inputs": tuple(inputs.split()), "box": dict(zip(names, box, strict=True))}
    return type(name, (), own | {"parameters": parameters, "f": f, "kappa": kappa} | parts)


def derived(name: str, base: type, **parts: Any) -> type:
    """The class with other numbers."""
    return type(name, (base,), parts)


Heater = plant(  # A heated block and its sensor, duty Q of 255, temperature T in K: tau T' = gain Q - (T - ambient).
    "Heater", "T", "Q", lambda x, u, t, p, M: [(p.gain * u.Q - (x.T - p.ambient)) / p.tau],
    lambda x, t, p, M: [(p.target - p.ambient - p.strength * (x.T - p.target)) / p.gain],
    {"tau": 150.0, "gain": 0.4, "ambient": 300.0, "target": 330.0, "strength": 2.0}, (300.0, 345.0),
    units={"T": "K", "Q": "1/255"}, guess=(330.0,), V=lambda x, t, p, M: (x.T - p.target) ** 2,
)  # fmt: skip
HeaterFahrenheit = derived(  # The same, another board, T in °F.
    "HeaterFahrenheit", Heater, units={"T": "°F", "Q": "1/255"}, box={"T": (74.0, 130.0)}, guess=(110.0,),
    parameters={"tau": 150.0, "gain": 0.25, "ambient": 74.0, "target": 110.0, "strength": 2.0},
)  # fmt: skip
HeaterSensor = plant(  # The block B and a sensor T that lags: the rival of `Heater` with a dead time; T is measured.
    "HeaterSensor", "T B", "Q", lambda x, u, t, p, M: [(x.B - x.T) / p.lag, (p.gain * u.Q - (x.B - p.ambient)) / p.tau],
    lambda x, t, p, M: [(p.target - p.ambient - p.strength * (x.B - p.target)) / p.gain],
    {"tau": 150.0, "lag": 15.0, "gain": 0.4, "ambient": 300.0, "target": 330.0, "strength": 1.0}, (300.0, 345.0),
    (300.0, 345.0), units={"T": "K", "B": "K", "Q": "1/255"}, guess=(330.0, 330.0),
)  # fmt: skip
Buck = plant(  # A buck converter's output filter: voltage v, its rate r in V/ms; v falls as the control voltage rises.
    "Buck", "v r", "u",
    lambda x, u, t, p, M: [x.r, p.w**2 * (p.v0 + p.gain * (u.u - p.u0) - x.v) - 2 * p.zeta * p.w * x.r],
    lambda x, t, p, M: [p.u0 + p.strength * (x.v - p.v0)],
    {"w": 4.0, "zeta": 0.6, "gain": -8.0, "v0": 13.0, "u0": 2.35, "strength": 0.05}, (11.5, 16.0), (-5.0, 5.0),
    units={"v": "V", "r": "V/ms", "u": "V"}, time_unit="ms", guess=(13.0, 0.0),
)  # fmt: skip
House = plant(  # A house: heater power Ph, outdoor temperature Ta, indoor Ti; one capacity. C Ti' = Ph + (Ta - Ti) / R.
    "House", "Ti", "Ph Ta", lambda x, u, t, p, M: [(u.Ph + (u.Ta - x.Ti) / p.R) / p.C],
    lambda x, t, p, M: [(p.target - 5.0) / p.R - p.strength * p.C * (x.Ti - p.target), 5.0],
    {"R": 0.5, "C": 30.0, "target": 18.0, "strength": 0.1}, (14.0, 22.0),
    units={"Ti": "degC", "Ph": "kW", "Ta": "degC"}, time_unit="h", guess=(18.0,),
)  # fmt: skip
Arm = plant(  # A flexible robot arm, one mode: reaction torque u, acceleration y. One unit of time is one sample.
    "Arm", "x v", "u", lambda x, u, t, p, M: [x.v, p.k * u.u - p.w2 * x.x - p.c * x.v],
    lambda x, t, p, M: [-p.strength * x.v], {"w2": 0.3, "c": 0.05, "k": 0.1, "strength": 1.0}, (-5.0, 5.0), (-5.0, 5.0),
    output=lambda x, t, p, M: [-p.w2 * x.x - p.c * x.v], outputs=("y",),
)  # fmt: skip
BallBeam = plant(  # A ball on a beam: angle a of the beam, position r of the ball. r'' = g (a + a0) - d r'.
    "BallBeam", "r v", "a", lambda x, u, t, p, M: [x.v, p.g * (u.a + p.a0) - p.d * x.v],
    lambda x, t, p, M: [-p.strength * (p.strength * x.r + 2 * x.v) / p.g - p.a0],
    {"g": 5.0, "d": 0.1, "a0": 0.0, "strength": 1.0}, (-0.1, 0.1), (-0.1, 0.1), output="r", outputs=("y",),
)  # fmt: skip
Glass = plant(  # A furnace: heating q1, cooling q2 and q3, one temperature T, all scaled; time counts samples.
    "Glass", "T", "q1 q2 q3", lambda x, u, t, p, M: [-p.a * x.T + p.b1 * u.q1 + p.b2 * u.q2 + p.b3 * u.q3],
    lambda x, t, p, M: [-p.strength * x.T, 0.0, 0.0], {"a": 0.05, "b1": 0.01, "b2": 0.01, "b3": 0.01, "strength": 1.0},
    (-3.0, 3.0),
)  # fmt: skip
HeaterCelsius = derived(  # A heater of a board, duty Q in %, temperature T in degC.
    "HeaterCelsius", Heater, units={"T": "degC", "Q": "%"}, box={"T": (20.0, 60.0)}, guess=(40.0,),
    parameters={"tau": 150.0, "gain": 0.6, "ambient": 21.0, "target": 40.0, "strength": 2.0},
    input_bounds=((0.0, 100.0),),
)  # fmt: skip
SmallBoard = derived(  # The single-board heater system: a thin plate of steel with its coil, and a constant fan.
    "SmallBoard", HeaterCelsius, box={"T": (22.0, 45.0)}, guess=(30.0,),
    parameters={"tau": 40.0, "gain": 0.2, "ambient": 26.0, "target": 32.0, "strength": 2.0},
)  # fmt: skip


def _heaters(x, u, t, p, M):
    flow, (one, two) = p.share * (x.T2 - x.T1), (x.T1 - p.ambient, x.T2 - p.ambient)
    return [(p.gain1 * u.Q1 - one + flow) / p.tau, (p.gain2 * u.Q2 - two - flow) / p.tau]


TwoHeaters = plant(  # Two heaters side by side: each warms its own sensor, and they exchange heat. Times in s.
    "TwoHeaters", "T1 T2", "Q1 Q2", _heaters,
    lambda x, t, p, M: [
        (40.0 - p.ambient - p.strength * (x.T1 - 40.0)) / p.gain1,
        (35.0 - p.ambient - p.strength * (x.T2 - 35.0)) / p.gain2,
    ],
    {"tau": 150.0, "share": 0.3, "gain1": 0.6, "gain2": 0.3, "ambient": 21.0, "strength": 1.0}, (20.0, 60.0),
    (20.0, 60.0), units={"T1": "degC", "T2": "degC", "Q1": "%", "Q2": "%"}, guess=(30.0, 30.0),
    input_bounds=((0.0, 100.0), (0.0, 100.0)),
)  # fmt: skip
Servo = plant(  # A hobby servo: the angle y follows the commanded angle a with a lag.
    "Servo", "y", "a", lambda x, u, t, p, M: [(p.K * u.a + p.b - x.y) / p.tau],
    lambda x, t, p, M: [-(p.strength * x.y + p.b) / p.K], {"K": 1.0, "tau": 0.05, "b": 0.0, "strength": 1.0},
    (-0.7, 0.7),
)  # fmt: skip
ServoSpring = plant(  # A hobby servo of second order: a spring towards the command, and friction.
    "ServoSpring", "y v", "a", lambda x, u, t, p, M: [x.v, p.kp * (p.K * u.a - x.y) - p.kd * x.v],
    lambda x, t, p, M: [-p.strength * x.y / p.K], {"kp": 400.0, "kd": 30.0, "K": 1.0, "strength": 0.5}, (-0.7, 0.7),
    (-10.0, 10.0), output="y", outputs=("angle",),
)  # fmt: skip
Silverbox = plant(  # An electronic Duffing oscillator: voltage u in, voltage y out; its spring hardens by k3.
    "Silverbox", "y v", "u", lambda x, u, t, p, M: [x.v, p.g * u.u - p.z * x.v - p.w**2 * x.y - p.k3 * x.y**3],
    lambda x, t, p, M: [-p.strength * x.v], {"w": 430.0, "z": 20.0, "g": 180000.0, "k3": 700000.0, "strength": 0.0001},
    (-0.3, 0.3), (-100.0, 100.0), output="y", outputs=("V2",),
)  # fmt: skip


def _tanks(x, u, t, p, M):
    s1, s2 = M.sqrt(M.maximum(x.x1, 1e-3)), M.sqrt(M.maximum(x.x2, 1e-3))
    return [-p.k2 * s1 + p.k4 * u.u, p.k2 * s1 - p.k3 * s2]


Tanks = plant(  # Two tanks, one above the other: pump voltage u, level of the lower one y; outlets may differ.
    "Tanks", "x1 x2", "u", _tanks, lambda x, t, p, M: [p.k3 * 2.2 / p.k4 - p.strength * (x.x2 - 5.0)],
    {"k2": 0.05, "k3": 0.05, "k4": 0.05, "strength": 0.1}, (0.5, 10.0), (0.5, 10.0), output="x2", outputs=("y",),
    guess=(5.0, 5.0),
)  # fmt: skip
TwoTanks = derived(  # The same, another pair, of which both levels are measured.
    "TwoTanks", Tanks, outputs=("y1", "y2"), output=lambda x, t, p, M: [x.x1, x.x2],
    parameters={"k2": 0.1, "k3": 0.1, "k4": 0.2, "strength": 0.1},
)  # fmt: skip
Exchanger = plant(  # A heat exchanger steam-water: flow q of the liquid, its outlet temperature th.
    "Exchanger", "th", "q", lambda x, u, t, p, M: [(p.K * u.q + p.T0 - x.th) / p.tau],
    lambda x, t, p, M: [(97.0 - p.T0 - p.strength * (x.th - 97.0)) / p.K],
    {"K": -10.0, "tau": 20.0, "T0": 100.0, "strength": 1.0}, (90.0, 105.0), guess=(97.0,), input_bounds=((0.0, 1.0),),
)  # fmt: skip
Wheel = plant(  # A wheel: duty u of 255, speed w in rpm; w0 stands for the dead band.
    "Wheel", "w", "u", lambda x, u, t, p, M: [(p.K * u.u + p.w0 - x.w) / p.tau],
    lambda x, t, p, M: [(200.0 - p.w0 - p.strength * (x.w - 200.0)) / p.K],
    {"K": 4.0, "tau": 0.1, "w0": 0.0, "strength": 1.0}, (0.0, 400.0), units={"w": "rpm", "u": "1/255"}, guess=(100.0,),
)  # fmt: skip
WheelAngle = plant(  # A wheel: duty u, angle th in counts of its encoder. th'' = (K u - th') / tau.
    "WheelAngle", "th w", "u", lambda x, u, t, p, M: [x.w, (p.K * u.u - x.w) / p.tau],
    lambda x, t, p, M: [-p.strength * (x.th - 2000.0) / p.K], {"K": 50.0, "tau": 0.1, "strength": 1.0}, (0.0, 10000.0),
    (-3000.0, 3000.0), output="th", outputs=("count",),
)  # fmt: skip
Motor = plant(  # Two coupled motors HSM150: torque M in Nm, speed w in rad/s; M0 is Coulomb friction.
    "Motor", "w", "M", lambda x, u, t, p, M: [(u.M + p.M0 - p.B * x.w) / p.J],
    lambda x, t, p, M: [p.B * 100.0 - p.M0 - p.strength * p.B * (x.w - 100.0)],
    {"J": 1e-3, "B": 1e-3, "M0": 0.0, "strength": 1.0}, (-300.0, 300.0),
)  # fmt: skip
Gyro = plant(  # A gyroscope fixed to a motor's axis: its rate follows the motor's speed with a lag.
    "Gyro", "av", "mv", lambda x, u, t, p, M: [(p.K * u.mv + p.b - x.av) / p.tau],
    lambda x, t, p, M: [-(p.strength * x.av + p.b) / p.K], {"K": 1.0, "tau": 0.01, "b": 0.0, "strength": 1.0},
    (-100.0, 100.0),
)  # fmt: skip
Propeller = plant(  # A brushless motor with its controller: pulse u in us, speed w in rpm.
    "Propeller", "w", "u", lambda x, u, t, p, M: [(p.K * (u.u - p.u0) - x.w) / p.tau],
    lambda x, t, p, M: [p.u0 - p.strength * x.w / p.K], {"K": 0.1, "tau": 0.1, "u0": 1500.0, "strength": 1.0},
    (-100.0, 100.0), units={"w": "rpm", "u": "us"},
)  # fmt: skip
Roll = plant(  # A multicopter: roll rate r by the mixer's roll command u.
    "Roll", "r", "u", lambda x, u, t, p, M: [p.g * (u.u + p.b) - p.d * x.r],
    lambda x, t, p, M: [-p.strength * x.r - p.b], {"g": 100.0, "d": 2.0, "b": 0.0, "strength": 0.05}, (-3.0, 3.0),
    units={"r": "rad/s"},
)  # fmt: skip
HairDryer = plant(  # A tube with a fan (Feedback PT326): heater voltage u, thermocouple y downstream, both in V.
    "HairDryer", "y", "u", lambda x, u, t, p, M: [(p.K * u.u + p.y0 - x.y) / p.tau],
    lambda x, t, p, M: [(5.0 - p.y0 - p.strength * (x.y - 5.0)) / p.K],
    {"K": 0.9, "tau": 0.4, "y0": 0.0, "strength": 1.0}, (3.0, 7.0), guess=(5.0,),
)  # fmt: skip
Lamp = plant(  # A halogen lamp heats a thin plate: voltage u, temperature T in degC behind the plate.
    "Lamp", "T", "u", lambda x, u, t, p, M: [(p.K * u.u + p.T0 - x.T) / p.tau],
    lambda x, t, p, M: [(130.0 - p.T0 - p.strength * (x.T - 130.0)) / p.K],
    {"K": 15.0, "tau": 50.0, "T0": 40.0, "strength": 1.0}, (70.0, 200.0), guess=(130.0,),
)  # fmt: skip
GasFurnace = plant(  # A gas furnace: methane feed u in cubic feet per min, CO2 y in % at the outlet.
    "GasFurnace", "y", "u", lambda x, u, t, p, M: [(p.K * u.u + p.y0 - x.y) / p.tau],
    lambda x, t, p, M: [(53.5 - p.y0 - p.strength * (x.y - 53.5)) / p.K],
    {"K": -2.0, "tau": 20.0, "y0": 53.5, "strength": 1.0}, (45.0, 61.0), guess=(53.5,),
)  # fmt: skip
Drive = plant(  # Two electric motors coupled by a flexible belt: the sensor gives the pulley's speed without its sign.
    "Drive", "w a", "u", lambda x, u, t, p, M: [x.a, p.k * u.u - p.w2 * x.w - p.c * x.a],
    lambda x, t, p, M: [p.w2 / p.k - p.strength * (x.w - 1.0)], {"w2": 30.0, "c": 3.0, "k": 60.0, "strength": 0.1},
    (-4.0, 4.0), (-40.0, 40.0), output=lambda x, t, p, M: [M.sqrt(x.w**2 + 1e-4)], outputs=("z",), guess=(0.5, 0.0),
)  # fmt: skip
Crane = plant(  # A hydraulic crane: valve u, oil pressure y, both scaled; one unit of time is one sample.
    "Crane", "x v", "u", lambda x, u, t, p, M: [x.v, p.k * u.u + p.b - p.w2 * x.x - p.c * x.v],
    lambda x, t, p, M: [-p.strength * x.v], {"w2": 0.1, "c": 0.1, "k": 0.1, "b": 0.0, "strength": 0.1}, (-4.0, 4.0),
    (-4.0, 4.0), output="x", outputs=("y",),
)  # fmt: skip
Wing = plant(  # A wing in flutter, one mode: excitation u, response y; one unit of time is one sample.
    "Wing", "x v", "u", lambda x, u, t, p, M: [x.v, p.k * u.u - p.w2 * x.x - p.c * x.v],
    lambda x, t, p, M: [-p.strength * x.v], {"w2": 0.2, "c": 0.05, "k": 0.1, "strength": 0.1}, (-4.0, 4.0), (-4.0, 4.0),
    output="x", outputs=("y",),
)  # fmt: skip
