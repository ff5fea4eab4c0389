"""Late actions: which of them acts, exact predictions give the loop without delay, and wrong settings one line."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

gym = pytest.importorskip("gymnasium")
pytest.importorskip("mujoco")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import npred  # noqa: E402
import npred_gym  # noqa: E402
from npred.base import grid  # noqa: E402
from npred.base.errors import ConfigError, NpredError  # noqa: E402
from npred.lab.training.data.dataset import Dataset  # noqa: E402
from npred_gym import Ahead, DelayedActions, Simulator, state_of  # noqa: E402
from npred_gym.path import HeldAction  # noqa: E402

ALL = ("Pendulum-v1", "InvertedPendulum-v5", "InvertedDoublePendulum-v5", "Reacher-v5", "Swimmer-v5", "HalfCheetah-v5",
       "Hopper-v5")  # fmt: skip


def law(env):
    """A smooth policy of no merit."""
    sizes = env.action_space.shape[0], env.observation_space.shape[0]
    weights = np.random.default_rng(0).normal(size=sizes)
    high = env.action_space.high
    return lambda observation: (high * np.tanh(weights @ observation)).astype(high.dtype)


def loop(env, act, steps, seed=0):
    """Observations and rewards of an episode under act(observation, info)."""
    observation, info = env.reset(seed=seed)
    observations, rewards, over = [observation], [], False
    while len(rewards) < steps and not over:
        observation, reward, terminated, truncated, info = env.step(act(observation, info))
        over = terminated or truncated
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("d", [0, 1, 8])
def test_ahead_is_the_loop_without_delay_after_the_first_actions(name, d):
    """To the bit, with the environment's own simulator: what is late are the first d steps alone."""
    bare = gym.make(name)
    policy, count = law(bare), iter(range(10**6))
    zero = np.zeros(bare.action_space.shape, np.float32)
    expected = loop(bare, lambda o, info: zero if next(count) < d else policy(o), 40)
    late = DelayedActions(gym.make(name), d)
    for seed, told in ((0, True), (0, False)):  # with info and without
        ahead = Ahead(policy, late)
        got = loop(late, ahead if told else lambda o, info, ahead=ahead: ahead(o), 40, seed)
        assert all(np.array_equal(a, b) for a, b in zip(got, expected, strict=True))


@pytest.mark.parametrize("name", ALL[:4])
def test_an_environment_that_is_held_gives_the_same_episode(name):
    bare, late = gym.make(name), DelayedActions(gym.make(name), 5, held=True)
    policy = law(bare)
    expected, rewards = loop(bare, lambda o, info: policy(o), 30)
    got, paid = loop(late, Ahead(policy, late), len(rewards) + 5)
    assert np.array_equal(got[5:], expected) and np.array_equal(paid[5:], rewards) and not paid[:5].any()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 12), st.integers(0, 4), st.integers(0, 10**6))
def test_old_observations_and_fractions_cost_nothing_but_the_start(halves, old, seed):
    """Half control steps of InvertedPendulum are one time step of MuJoCo."""
    policy = law(gym.make("InvertedPendulum-v5"))
    late = DelayedActions(gym.make("InvertedPendulum-v5"), halves / 2, old)
    ahead, inner, acted = Ahead(policy, late), late.unwrapped, []
    simulate = inner._step_mujoco_simulation

    def noted(control, frames):
        for _ in range(frames):
            acted.append((inner._get_obs(), float(np.ravel(control)[0])))
            simulate(control, 1)

    inner._step_mujoco_simulation = noted
    loop(late, ahead, 20, seed)
    assert late.delay == halves / 2
    for k in range(halves + 2 * old, len(acted)):  # what acts is the policy's of the moment at which it began to act
        begin = k - (k - halves) % 2
        assert acted[k][1] == pytest.approx(float(policy(acted[begin][0])[0]), abs=0)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0, 6), min_size=20, max_size=20))
def test_the_newest_that_has_arrived_acts_whatever_the_delays(delays):
    """Against a list of all arrivals; an environment without substeps takes an action in at the next step."""
    draws = iter(delays)
    late = DelayedActions(gym.make("Pendulum-v1"), lambda random: next(draws))
    late.reset(seed=0)
    for now in range(len(delays)):
        *_, info = late.step(np.array([now / 100], np.float32))
        newest = max((k for k in range(now + 1) if k + delays[k] <= now + 1e-9), default=-1)
        assert info["acting"] == np.float32(max(newest, 0) / 100)
        assert info["queue"][:, 0].tolist() == [np.float32(k / 100) for k in range(newest + 1, now + 1)]
        assert all(k + delays[k] <= when + 1e-9 and when == now for k, when in info["arrived"].items())


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 5), st.floats(0, 1))
def test_jitter_is_reproducible_and_within_its_bounds(seed, delay, share):
    late, runs = DelayedActions(gym.make("Pendulum-v1"), delay, jitter=share * delay), []
    for _ in range(2):
        late.reset(seed=seed)
        infos = [late.step(np.array([0.0], np.float32))[4] for _ in range(20)]
        runs.append({k: when for info in infos for k, when in info["arrived"].items()})
    assert runs[0] == runs[1]
    assert all((1 - share) * delay - 1e-9 <= a - k < (1 + share) * delay + 1 + 1e-9 for k, a in runs[0].items())


def test_stages_and_functions_and_seconds():
    make = lambda *a, **k: DelayedActions(gym.make("InvertedPendulum-v5"), *a, **k)
    assert make(0.12, unit="s").delay == 3.0 and make(0.13, unit="s").delay == 3.5  # a control step is 40 ms
    assert make([1, 0.5, 2]).delay == 3.5 and make(0.04, 0.05, unit="s").observation_delay == 2
    drawn = make(lambda random: random.integers(1, 4))
    assert drawn.delay is None
    runs = []
    for _ in range(2):
        drawn.reset(seed=3)
        runs.append([drawn.step(np.array([0.1 * k], np.float32))[4]["acting"][0] for k in range(12)])
    assert runs[0] == runs[1] and len(set(runs[0])) > 3


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["Pendulum-v1", "InvertedPendulum-v5"])
def test_gymnasiums_own_check(name):
    check_env(DelayedActions(gym.make(name), 2, 1, 0.5), skip_render_check=True)


@pytest.mark.parametrize("name", ALL)
def test_a_state_is_read_from_an_observation(name):
    env = gym.make(name)
    simulator, policy = Simulator(env, state_of(env)), law(env)
    observation, _ = env.reset(seed=1)
    observation, *_ = env.step(policy(observation))
    action = policy(observation)
    expected, *_ = env.step(action)
    got = simulator(observation, [HeldAction(action, 1.0)])
    at = slice(0, 8) if name == "InvertedDoublePendulum-v5" else slice(None)  # the last is a force
    np.testing.assert_allclose(got[at], expected[at], atol=1e-5)


def test_a_delay_from_a_recording_and_a_policy_with_predict():
    env = gym.make("InvertedPendulum-v5")
    identified = SimpleNamespace(D=np.array([0.32]), refused=False)
    policy = law(env)
    model = SimpleNamespace(predict=lambda o, deterministic: (policy(o), None))
    ahead = Ahead(model, env, delay=identified)
    assert ahead.delay == pytest.approx(8) and np.array_equal(
        ahead(np.zeros(4)), Ahead(policy, env, delay=8)(np.zeros(4))
    )
    with pytest.raises(ConfigError, match="expected one delay that the recording tells"):
        Ahead(policy, env, delay=SimpleNamespace(D=np.array([0.32]), refused=True))


PLANT = """
import numpy as np
import npred_gym


def policy(observation):
    return np.clip([0.722, 6.83, 0.923, 1.084] @ observation, -3, 3)[None].astype(np.float32)


class Cart(npred_gym.plant("InvertedPendulum-v5", policy)):
    pass
"""


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    path = tmp_path_factory.mktemp("plant") / "cart.py"
    path.write_text(PLANT)
    return npred.plant(f"{path}:Cart")


def test_a_black_box_predicts_what_the_environment_does(cart):
    env = gym.make("InvertedPendulum-v5")
    observation, _ = env.reset(seed=2)
    pieces = [HeldAction(np.array([u], np.float32), steps) for u, steps in ((1.0, 1.0), (-0.5, 1.5), (2.0, 0.5))]
    expected = Simulator(env)(observation, pieces)
    for predictor in (npred.predictor(cart, "rollout", nx=9), npred.predictor(cart, "rk4", nx=9)):
        np.testing.assert_allclose(npred_gym.Model(predictor, env)(observation, pieces), expected, atol=1e-4)
    with pytest.raises(ConfigError, match="expected a plant or a predictor"):
        npred_gym.Model(lambda o: o, env)


def test_cells_keep_the_mean_of_the_actions():
    pieces = [HeldAction(np.array([u]), steps) for u, steps in ((1.0, 1.0), (-2.0, 2.0), (4.0, 1.0))]
    u = npred_gym.model.nodes(pieces, 9)
    assert np.dot(grid.trapezoid(9), u[:, 0]) == pytest.approx((1.0 - 4.0 + 4.0) / 4)
    assert u[0] == 1.0 and u[4] == -2.0 and u[2] == -0.5


def test_recorded_loops_are_data_of_the_plant(cart, tmp_path):
    env = gym.make("InvertedPendulum-v5")
    policy = cart.declaration.kappa
    act = lambda o: policy(o[None], 0.0, None)[0].astype(np.float32)
    npred_gym.record(tmp_path / "a.h5", env, act, (2, 4), rows=200, episodes=10, steps=30)
    data = Dataset.read(tmp_path / "a.h5")
    data.fit(cart)
    assert set(np.round(data.D_hat / 0.04)) == {2, 4} and 0 < data.test.sum() < len(data)
    exact = npred.predictor(cart, "rollout", nx=9)
    held = np.ptp(data.u, axis=(1, 2)) < 0.05  # such inputs are read between nodes as they were
    assert held.sum() > 20
    P = exact(data.X[held], data.u[held], data.D_hat[held])[:, -1]
    np.testing.assert_allclose(P, data.P[held, -1], atol=5e-3)


def heavier(twin):
    twin.model.body_mass[:] *= 1.1
    twin.model.body_inertia[:] *= 1.1


def test_a_quiet_law_stands_on_a_model_that_is_wrong():
    """Eight steps late it falls at once without a prediction, and stands with one whose masses are 10 % too large."""
    late = DelayedActions(gym.make("InvertedPendulum-v5"), 8)
    policy = lambda o: np.clip([0.722, 6.83, 0.923, 1.084] @ o, -3, 3)[None].astype(np.float32)
    assert len(loop(late, lambda o, info: policy(o), 1000)[1]) < 30
    assert len(loop(late, Ahead(policy, late, Simulator(late, change=heavier)), 1000)[1]) == 1000


@pytest.mark.parametrize("name", ["Pendulum-v1", "InvertedPendulum-v5"])
@pytest.mark.parametrize("what", ["another", "another late", "its simulator", "held", "old"])
def test_an_environment_that_stands_still_is_refused(name, what):
    late, another = DelayedActions(gym.make(name), 3), gym.make(name)
    another.reset(seed=0)
    policy, still = law(another), "stands still; give state_of(env)"
    if what in ("held", "old"):  # what may stand still is not refused, even where a sensor has noise
        late = DelayedActions(gym.make(name), 3, 2 * (what == "old"), held=what == "held")
        ahead, noise = Ahead(policy, late), np.random.default_rng(0)
        noisy = lambda o, info: ahead((o + 1e-3 * noise.normal(size=o.shape)).astype(o.dtype), info)
        assert len(loop(late, noisy, 5)[1]) == 5
        return
    if what == "another late":
        another = DelayedActions(another, 3)
        another.reset(seed=0)
    ahead = Ahead(policy, late, Simulator(another)) if what == "its simulator" else Ahead(policy, another, None, 3)
    with pytest.raises(ConfigError, match=re.escape(still)):
        loop(late, ahead, 5)
    told = Ahead(policy, late, Simulator(gym.make(name), state_of(late)))
    told.predictor.env.reset(seed=0)
    assert len(loop(late, told, 5)[1]) == 5


CART = "InvertedPendulum-v5"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda env: DelayedActions(env, -1), "delay: expected a time, 0 or more"),
        (lambda env: DelayedActions(env, 2, jitter=3), "jitter: expected at most the delay"),
        (lambda env: DelayedActions(env, 2, unit="ms"), 'unit: expected "steps" or "s"'),
        (lambda env: DelayedActions(env, 2, first=[0, 1]), "action: expected shape (1,)"),
        (lambda env: DelayedActions(gym.make("CartPole-v1"), 2), "expected actions of a Box"),
        (lambda env: DelayedActions(gym.wrappers.RescaleAction(env, -1, 1), 2), "RescaleAction: expected around"),
        (lambda env: DelayedActions(gym.make("MountainCarContinuous-v0"), 1, unit="s"), "give times in steps"),
        (lambda env: DelayedActions(env, lambda random: -1.0), "expected a function that draws a time"),
        (lambda env: Ahead(law(env), env), "delay: expected a number, got None"),
        (lambda env: Ahead(law(env), env, delay="observer"), "delay: expected a number, got 'observer'"),
        (lambda env: Ahead(law(env), env, delay=-1), "delay: expected 0 or more"),
        (lambda env: Ahead(3, env, delay=1), "policy: expected a function"),
        (lambda env: npred_gym.Model(3, env), "predictor: expected a plant or a predictor"),
        (lambda env: npred_gym.plant("Pendulum-v1", law(env)), "plant: expected an environment of MuJoCo"),
        (lambda env: DelayedActions(DelayedActions(env, 4), 4), "DelayedActions: expected one, got one around another"),
        (lambda env: DelayedActions(env, 8000), "these are 8000 control steps, of episodes of 1000; is it in ms?"),
        (lambda env: DelayedActions(env, 1, 8000), "observation_delay: these are 8000 control steps"),
        (lambda env: Ahead(law(env), env, delay=8000), "these are 8000 control steps"),
        (lambda env: DelayedActions(env, []), "delay: expected a time, 0 or more, or several"),
        (lambda env: DelayedActions(env, [1, 1], jitter=[1, 1, 1]), "jitter: expected 1 or 2 numbers"),
        (lambda env: DelayedActions(env, lambda random: 1, jitter=1), "draw it in the function"),
        (lambda env: Ahead(law(env), env, delay="observer"), "need a traced plant under a law in continuous time"),
        (lambda env: Ahead(law(env), DelayedActions(env, lambda random: 1)), "Ahead(policy, env, delay=4)"),
        (lambda env: DelayedActions(env, 1).step(np.zeros(1)), "expected a reset before the first step"),
        (lambda env: Ahead(law(env), DelayedActions(env, 1))(np.zeros(4)), "without a state; reset it first"),
        (lambda env: Ahead(lambda o: [0.0], gym.make("Pendulum-v1"), delay=1)(np.zeros(3)), "reset it first"),
        (lambda env: Ahead(lambda o: np.array([np.nan]), env, delay=1)(np.zeros(4)), "policy: expected finite numbers"),
        (lambda env: Ahead(lambda o: (np.zeros(1), None), env, delay=1)(np.zeros(4)), "not model.predict"),
        (
            lambda env: Ahead(law(env), gym.wrappers.ClipAction(DelayedActions(env, 8))),
            "give the DelayedActions inside",
        ),
        (
            lambda env: Ahead(law(env), gym.wrappers.FrameStackObservation(env, 2), delay=1),
            "FrameStackObservation: exp",
        ),
        (lambda env: Ahead(len, gym.make("CartPole-v1"), delay=1), "expected actions of a Box"),
        (lambda env: Ahead(law(env), env, 6), "did you mean delay=6?"),
        (lambda env: Ahead(law(env), env, 0), "did you mean delay=0?"),
        (lambda env: Ahead(law(env), env, "rk4", 1), "predictor: expected a plant or predictor of npred"),
        (lambda env: Ahead(law(env), env, Simulator, 1), "predictor: expected a plant or predictor of npred"),
        (lambda env: Ahead(law(env), env, env, 1), "predictor: expected a plant or predictor of npred"),
        (lambda env: Ahead(law(env), env, Simulator(gym.make("Hopper-v5")), 1), "with the spaces of"),
        (lambda env: Ahead(law(env), env, lambda o, pieces: o[:2], 1)(np.zeros(4)), "of shape (4,), got (2,)"),
    ],
)
def test_what_is_wrong_is_one_line(make, words):
    with pytest.raises(NpredError, match=re.escape(words)) as caught:
        env = make(gym.make(CART))
        env.reset(seed=0)
        env.step(np.zeros(1, np.float32))
    assert "\n" not in str(caught.value) and isinstance(caught.value, ConfigError)
