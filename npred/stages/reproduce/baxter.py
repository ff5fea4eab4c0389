"""The first five links of the Baxter arm by its Denavit-Hartenberg table, as matrices on batches: (..., 5) angles.

Table: Smith, Yang, Li, Ma, Bruce, Dynamic modelling and control of a Baxter robot (IEEE 7558740, 2016). The method is
the textbook's sum over links of traces of 4 × 4 matrices.
"""

import numpy as np

from npred.robots.rigid_body import Body

LINKS, GRAVITY = 5, 9.81
LOW = np.array([-1.7016, -2.147, -3.0541, -0.05, -3.059])
HIGH = np.array([1.7016, 1.047, 3.0541, 2.618, 3.059])
FASTEST, STRONGEST = np.array([2.0] * 4 + [4.0]), np.array([50.0] * 4 + [15.0])
SHIFT = np.array([0.2703, 0.0, 0.3644, 0.0, 0.3743])  # d
LENGTH = np.array([0.069, 0.0, 0.069, 0.0, 0.01])  # a
TWIST = np.array([-0.5, 0.5, -0.5, 0.5, -0.5]) * np.pi  # α
MASS = np.array([5.70044, 3.22698, 4.31272, 2.07206, 2.24665])
CENTRE = np.array([
    [-0.05117, 0.07908, 0.00086], [0.00269, -0.00529, 0.06845], [-0.07176, 0.08149, 0.00132],
    [0.00159, -0.01117, 0.02618], [-0.01168, 0.13111, 0.0046],
])  # fmt: skip
MOMENTS = np.array([  # Ixx, Iyy, Izz, Ixy, Iyz, Ixz
    [0.0470910226, 0.035959884, 0.0376697645, -0.0061487003, -0.0007808689, 0.0001278755],
    [0.027885975, 0.020787492, 0.0117520941, -0.0001882199, 0.0020767576, -0.00030096397],
    [0.0266173355, 0.012480083, 0.0284435520, -0.0039218988, -0.001083893, 0.0002927063],
    [0.0131822787, 0.009268520, 0.0071158268, -0.0001966341, 0.000745949, 0.0003603617],
    [0.0166774282, 0.003746311, 0.0167545726, -0.0001865762, 0.0006473235, 0.0001840370],
])  # fmt: skip
TURN = np.zeros((4, 4))  # d/dθ of a turn about z
TURN[0, 1], TURN[1, 0] = -1.0, 1.0


def tensors() -> np.ndarray:
    """The table's (5, 3, 3), its products as they stand there: the published code takes them for ∫ x y dm."""
    xx, yy, zz, xy, yz, xz = MOMENTS.T
    return np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), -1, 0)


def pseudo_inertia(about_centre: bool) -> np.ndarray:
    """∫ r r' dm of each link in homogeneous coordinates, (5, 4, 4).

    `about_centre`: the table's tensors are about the mass centres, as those of the arm's URDF file; the published code
    takes them as about the links' frames.
    """
    J, tensor = np.zeros((LINKS, 4, 4)), tensors()
    trace = 0.5 * np.trace(tensor, axis1=1, axis2=2)
    J[:, :3, :3] = tensor
    for k in range(3):
        J[:, k, k] = trace - tensor[:, k, k]
    if about_centre:
        J[:, :3, :3] += MASS[:, None, None] * CENTRE[:, :, None] * CENTRE[:, None, :]
    J[:, :3, 3] = J[:, 3, :3] = MASS[:, None] * CENTRE
    J[:, 3, 3] = MASS
    return J


def dynamics(q: np.ndarray, rates: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M (..., 5, 5), the vector h of Coriolis and centrifugal torques (..., 5) and that of gravity (..., 5)."""
    frames = _frames(q)
    first = np.zeros((*q.shape[:-1], LINKS, LINKS, 4, 4))  # [j, i]: of frame i by angle j
    for i in range(LINKS):
        for j in range(i + 1):
            first[..., j, i, :, :] = frames[j] @ TURN @ _between(frames, j, i + 1)
    M = np.einsum("...kjab,jbc,...ijac->...ik", first, J, first, optimize=True)
    swept = np.zeros((*q.shape[:-1], LINKS, 4, 4))  # second derivative of frame i along the rates
    for i in range(LINKS):
        for j in range(i + 1):
            for k in range(i + 1):
                low, high = min(j, k), max(j, k)
                second = frames[low] @ TURN @ _between(frames, low, high) @ TURN @ _between(frames, high, i + 1)
                swept[..., i, :, :] += (rates[..., j] * rates[..., k])[..., None, None] * second
    h = np.einsum("...jab,jbc,...ijac->...i", swept, J, first, optimize=True)
    down = np.array([0.0, 0.0, -GRAVITY, 0.0])
    centres = np.concatenate([CENTRE, np.ones((LINKS, 1))], axis=1)
    return M, h, -np.einsum("j,a,...ijab,jb->...i", MASS, down, first, centres, optimize=True)


def _frames(q: np.ndarray) -> list[np.ndarray]:
    """T_0,0 … T_0,5, each (..., 4, 4)."""
    frames = [np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))]
    for i in range(LINKS):
        sin, cos = np.sin(q[..., i]), np.cos(q[..., i])
        turned = np.zeros((*q.shape[:-1], 4, 4))
        turned[..., 0, 0] = turned[..., 1, 1] = cos
        turned[..., 1, 0], turned[..., 0, 1] = sin, -sin
        turned[..., 2, 2] = turned[..., 3, 3] = 1.0
        frames.append(frames[-1] @ turned @ _link(i))
    return frames


def _link(i: int) -> np.ndarray:
    """What follows the turn of joint i: along z and x, then the twist about x."""
    link = np.eye(4)
    sin, cos = np.sin(TWIST[i]), np.cos(TWIST[i])
    link[1:3, 1:3] = [[cos, -sin], [sin, cos]]
    link[0, 3], link[2, 3] = LENGTH[i], SHIFT[i]
    return link


def _between(frames: list[np.ndarray], first: int, last: int) -> np.ndarray:
    """T_first,last: the inverse of a turn and a shift, times the other."""
    A, B = frames[first], frames[last]
    result = np.zeros_like(B)
    back = np.swapaxes(A[..., :3, :3], -1, -2)
    result[..., :3, :3] = back @ B[..., :3, :3]
    result[..., :3, 3] = (back @ (B[..., :3, 3] - A[..., :3, 3])[..., None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def bodies() -> list[Body]:
    """The same links for npred.robots, their tensors about the mass centres; each frame is that behind the turn."""
    chain = []
    for i, tensor in enumerate(tensors()):
        before, link = _link(i - 1) if i else np.eye(4), _link(i)
        twist = link[:3, :3]
        # the table's products are the pseudo-inertia's: those of the tensor have the other sign
        sound = twist @ (2 * np.diag(np.diag(tensor)) - tensor) @ twist.T
        chain.append(Body(
            joint=f"joint{i + 1}", slides=False, turn=before[:3, :3], position=before[:3, 3],
            axis=np.array([0.0, 0.0, 1.0]), mass=float(MASS[i]), centre=twist @ CENTRE[i] + link[:3, 3], inertia=sound,
            damping=0.0, effort=float(STRONGEST[i]),
        ))  # fmt: skip
    return chain
