"""The adapter for Stable-Baselines3: with the package where it is installed, and with a stand-in of its base class elsewhere."""

import importlib
import sys
import types
from importlib.util import find_spec

import numpy as np
import pytest

import eupnea

NUM = 5


class StandIn:
    """What the adapter uses of Stable-Baselines3's `VecEnv`."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space

    def step(self, actions):
        self.step_async(actions)
        return self.step_wait()

    def _get_indices(self, indices):
        return range(self.num_envs) if indices is None else [indices] if isinstance(indices, int) else indices


@pytest.fixture(params=["stand-in", "Stable-Baselines3"])
def adapter(request, monkeypatch):
    monkeypatch.delitem(sys.modules, "eupnea.sb3", raising=False)
    if request.param == "stand-in":
        for name in ("stable_baselines3", "stable_baselines3.common"):
            monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
        vec_env = types.ModuleType("stable_baselines3.common.vec_env")
        vec_env.VecEnv = StandIn
        monkeypatch.setitem(sys.modules, vec_env.__name__, vec_env)
    elif find_spec("stable_baselines3") is None:
        pytest.skip("Stable-Baselines3 is not installed: pip install stable-baselines3")
    yield importlib.import_module("eupnea.sb3").VecPressureControl
    sys.modules.pop("eupnea.sb3", None)


def single_episodes(count, action, seed, **options):
    """Observations and rewards of the first episodes of a seed, each run alone."""
    environment = eupnea.PressureControl(**options)
    episodes = []
    for number in range(count):
        observation, _ = environment.reset(seed=seed, options={"number": number})
        observations, rewards, ended, info = [observation], [], False, {}
        while not ended:
            observation, reward, ended, _, info = environment.step(action(number))
            observations.append(observation)
            rewards.append(reward)
        episodes.append((observations, rewards, info))
    return episodes


def test_every_transition_is_one_of_an_episode_and_none_only_starts_one(adapter):
    # Every fifth environment opens its valve: those episodes are aborted, so that ends differ between environments.
    def action(number):
        return 1.0 if number % NUM == 0 else -0.6

    expected = single_episodes(3 * NUM, action, seed=4, hold=50)
    environments = adapter(num_envs=NUM, seed=4, reward_scale=0.5, hold=50)
    seen = environments.reset()
    actions = np.array([[action(number)] for number in range(NUM)], np.float32)
    at = [(number, 0) for number in range(NUM)]
    ends = []
    for _ in range(45):
        for index, (number, step) in enumerate(at):
            if number < len(expected):
                np.testing.assert_array_equal(seen[index], expected[number][0][step])
        seen, rewards, dones, infos = environments.step(actions)
        for index, (number, step) in enumerate(at):
            if number < len(expected):
                observations, of_episode, scores = expected[number]
                assert rewards[index] == np.float32(0.5 * of_episode[step])
                assert dones[index] == (step + 1 == len(of_episode))
                if dones[index]:
                    ends.append(number)
                    np.testing.assert_array_equal(infos[index]["terminal_observation"], observations[-1])
                    assert infos[index]["episode"]["r"] == pytest.approx(sum(of_episode))
                    assert infos[index]["episode"]["l"] == len(of_episode)
                    assert infos[index]["fault"] == scores["fault"]
                else:
                    assert infos[index] == {}
            at[index] = (number + NUM, 0) if dones[index] else (number, step + 1)
    assert {0, 5, 10, 1, 6} <= set(ends)
    assert expected[0][2]["fault"] == "HighPressure"


def test_a_seed_starts_again_with_its_first_episodes(adapter):
    environments = adapter(num_envs=2)
    environments.seed(7)
    first = environments.reset()
    second = environments.reset()
    assert not np.array_equal(first, second)
    environments.seed(7)
    np.testing.assert_array_equal(environments.reset(), first)
    environments.seed(None)
    np.testing.assert_array_equal(environments.reset(), second)


def test_attributes_and_methods_reach_each_environment(adapter):
    environments = adapter(num_envs=3, hold=50)
    assert environments.get_attr("steps") == [20, 20, 20]
    environments.set_attr("mark", 1, indices=[1])
    assert environments.get_attr("mark", indices=1) == [1]
    environments.env_method("close", indices=[0, 2])
    assert environments.env_is_wrapped(object) == [False] * 3
    with pytest.raises(RuntimeError, match="closed"):
        environments.reset()
    environments.close()


@pytest.mark.parametrize(
    ("actions", "reason"),
    [
        (np.zeros((NUM, 2)), "shape"),
        (np.zeros((NUM + 1, 1)), "shape"),
        (np.zeros(NUM), "shape"),
        (0.0, "shape"),
        (None, "shape"),
        ("open", "not numbers"),
        ([[0.0]] * (NUM - 1) + [[float("nan")]], "not finite"),
    ],
)
def test_wrong_actions_are_refused_before_an_environment_moves(adapter, actions, reason):
    environments, same = adapter(num_envs=NUM, hold=50), adapter(num_envs=NUM, hold=50)
    environments.reset()
    same.reset()
    with pytest.raises(ValueError, match=reason):
        environments.step(actions)
    right = np.full((NUM, 1), -0.6, np.float32)
    np.testing.assert_array_equal(environments.step(right)[0], same.step(right)[0])


def test_images_are_those_of_each_environment(adapter):
    environments = adapter(num_envs=2, hold=50, render_mode="rgb_array")
    environments.reset()
    environments.step(np.array([[-1.0], [0.2]], np.float32))
    images = environments.get_images()
    assert [(image.shape, image.dtype) for image in images] == [((240, 480, 3), np.uint8)] * 2
    np.testing.assert_array_equal(images[1], environments.envs[1].render())
    assert not np.array_equal(images[0], images[1])
    assert adapter(num_envs=2).get_images() == [None, None]


def test_wrong_names_and_numbers_are_refused(adapter):
    with pytest.raises(ValueError, match="choose from"):
        adapter("eupnea/Nothing-v0")
    with pytest.raises(ValueError, match="at least 1"):
        adapter(num_envs=0)


def test_without_stable_baselines3_the_module_says_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "eupnea.sb3", raising=False)
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    with pytest.raises(ImportError, match="pip install"):
        importlib.import_module("eupnea.sb3")


def test_ppo_learns_on_the_environment():
    sb3 = pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed: pip install stable-baselines3")
    adapter = importlib.import_module("eupnea.sb3").VecPressureControl
    environments = adapter(num_envs=4, hold=50)
    model = sb3.PPO("MlpPolicy", environments, n_steps=80, batch_size=80, learning_rate=3e-3, seed=1, device="cpu")
    before = eupnea.score(lambda seen: model.predict(seen, deterministic=True)[0], episodes=6, hold=50)
    model.learn(8000)
    after = eupnea.score(lambda seen: model.predict(seen, deterministic=True)[0], episodes=6, hold=50)
    assert after["score"] < 0.7 * before["score"], (before["score"], after["score"])
