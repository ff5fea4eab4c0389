"""The first five links of the Baxter arm as matrices on batches: (..., 5) angles.

The method is the textbook's sum over links of traces of 4 × 4 matrices; it shares the table with npred_robots, and
nothing else.
"""

import numpy as np

from npred_robots import baxter

LINKS, GRAVITY = 5, 9.81
TABLE = baxter.LINKS[:LINKS]
LOW, HIGH = np.array(baxter.ANGLES[:LINKS]).T
FASTEST = np.array(baxter.FASTEST[:LINKS])
STRONGEST, MASS = (np.array([getattr(link, name) for link in TABLE]) for name in ("effort", "mass"))
CENTRE = np.array([link.centre for link in TABLE])
TURN = np.zeros((4, 4))  # d/dθ of a turn about z
TURN[0, 1], TURN[1, 0] = -1.0, 1.0


def pseudo_inertia(about_centre: bool) -> np.ndarray:
    """∫ r r' dm of each link in homogeneous coordinates, (5, 4, 4).

    `about_centre`: the table's tensors are about the mass centres, as those of the arm's URDF file; the published code
    takes them as about the links' frames.
    """
    J, tensor = np.zeros((LINKS, 4, 4)), np.array([link.second for link in TABLE])
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
    """The transform behind the turn of joint i: along z and x, then the twist about x."""
    link, (d, a, alpha) = np.eye(4), TABLE[i][1:4]
    sin, cos = np.sin(alpha), np.cos(alpha)
    link[1:3, 1:3] = [[cos, -sin], [sin, cos]]
    link[0, 3], link[2, 3] = a, d
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
