"""The environment follows Gymnasium's rules and the command line's bits."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import eupnea
from eupnea._native import noise_seeds
from eupnea.environments import REGISTERED


def roll_out(environment, action, **reset):
    observation, _ = environment.reset(**reset)
    observations, rewards, ended, info = [observation], [], False, {}
    while not ended:
        observation, reward, ended, truncated, info = environment.step(action)
        assert not truncated
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards), info


@pytest.mark.parametrize("name", REGISTERED)
@pytest.mark.parametrize("observation", ["ours", "authors", "plain"])
def test_gymnasium_finds_nothing_to_complain_about(name, observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment = gymnasium.make(name, observation=observation, render_mode="rgb_array")
        check_env(environment.unwrapped)
    environment.close()


def test_the_mean_reward_is_minus_the_score_up_to_its_ends():
    environment = eupnea.PressureControl(hold=1)
    _, rewards, info = roll_out(environment, 0.0 - 0.6, seed=1)
    pressure, target, _ = environment._environment.inspiration()
    assert len(rewards) == environment.steps == 1000
    np.testing.assert_array_equal(rewards, -np.abs(np.float32(pressure) - np.float32(target)))
    # The score weighs the first and the last tick by half: the trapezoidal rule.
    errors = -rewards
    trapezoid = (errors.sum() - 0.5 * (errors[0] + errors[-1])) / 999
    assert info["score"] == pytest.approx(trapezoid, rel=1e-12)


def test_the_scores_of_a_pid_have_the_bits_of_evaluate():
    gains, pip, seed = (3.0, 30.0, 0.0), 20.0, 5
    result = eupnea.evaluate(gains=gains, pips=[pip], breaths=2, seed=seed)
    environment = eupnea.PressureControl(action="residual", gains=gains, hold=1, breaths=3)
    by_seed = []
    for noise in noise_seeds("evaluate", seed):
        info = roll_out(environment, 0.0, seed=0, options={"pip": pip, "noise": noise})[2]
        # The first breath starts from rest and is not scored.
        by_seed.append(sum(info["breath_scores"][1:]) * 0.5)
    assert sum(by_seed) * 0.2 == result["mean"]["pid"]["score"]


def test_a_plant_of_a_family_is_that_of_robust():
    result = eupnea.robust(gains=(3, 30), family="adult", plants=1, subset=0, breaths=1, seed=5)
    environment = gymnasium.make("eupnea/AdultFamily-v0", action="residual", gains=(3, 30), hold=1)
    info = roll_out(environment, np.zeros(1, np.float32), seed=5)[2]
    assert [info["score"]] == result["mean"]


def test_a_drawn_prescription_of_a_family_is_that_of_robust():
    options = {"family": "neonate", "prescriptions": "bedside"}
    result = eupnea.robust(gains=(3, 30), plants=3, subset=0, breaths=1, seed=5, **options)
    environment = eupnea.PressureControl(action="residual", gains=(3, 30), hold=1, **options)
    infos, settings = [], []
    for number in range(3):
        infos.append(roll_out(environment, 0.0, seed=5, options={"number": number})[2])
        settings.append(environment.settings)
    assert [np.mean([info["score"] for info in infos])] == pytest.approx(result["mean"], rel=1e-12)
    assert len({tuple(each.values()) for each in settings}) == 3
    for info, each in zip(infos, settings, strict=True):
        assert info["pip"] == each["pip"] and info["steps"] == pytest.approx(1000 * each["inspiratory_time"], abs=1)


def test_an_exploration_is_a_step_that_fades_or_a_triangle_of_its_number_and_seed():
    environment = eupnea.PressureControl(prescriptions="bedside")
    curves = []
    for number in range(60):
        environment.reset(seed=1, options={"number": number})
        curves.append(environment.exploration(4))
        assert len(curves[-1]) == pytest.approx(1000 * environment.settings["inspiratory_time"], abs=1)
        np.testing.assert_array_equal(curves[-1], environment.exploration(4))
    assert not np.array_equal(curves[-1], environment.exploration(5))
    steps = [curve for curve in curves if abs(curve[0]) > 1]
    assert 2 < len(steps) < 20 and all(np.argmax(curve) == 0 for curve in steps)
    assert max(abs(curve).max() for curve in curves) <= 100


def test_a_pid_gives_the_readings_of_collect_bit_for_bit(tmp_path):
    path = tmp_path / "recording.parquet"
    recording = eupnea.collect(out=path, breaths=1, seed=7, exploration="none", gains=(3, 30))
    inspiration = recording["phase"] == 0
    environment = eupnea.PressureControl(hold=1, observation="plain", action="residual", gains=(3, 30))
    chosen = {"pip": float(recording["pip"][0]), "noise": noise_seeds("collect", 7)[0]}
    observations, _, _ = roll_out(environment, 0.0, seed=0, options=chosen)
    np.testing.assert_array_equal(observations[:-1, 0], recording["pressure"][inspiration])
    np.testing.assert_array_equal(observations[1:, 4], recording["u_in"][inspiration])


def test_the_same_seed_gives_the_same_episode_and_another_seed_another_one(environment):
    first = roll_out(environment, -0.5, seed=1)
    again = roll_out(environment, -0.5, seed=1)
    other = roll_out(environment, -0.5, seed=2)
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("name", ["eupnea/NineLungs-v0", "eupnea/AdultFamily-v0", "eupnea/BreathingPatient-v0"])
def test_a_batch_runs_the_episodes_of_single_environments_on_any_number_of_threads(name, threads):
    batch = eupnea.vector(name, num_envs=5, seed=4, threads=threads, hold=50)
    single = gymnasium.make(name, hold=50).unwrapped
    observations, _ = batch.reset()
    expected = []
    for number in range(5):
        expected.append(roll_out(single, -0.6, seed=4, options={"number": number}))
    for step in range(batch.steps):
        for number, (seen, _, _) in enumerate(expected):
            np.testing.assert_array_equal(observations[number], seen[step])
        observations, rewards, ended, _, infos = batch.step(np.full((5, 1), -0.6))
        assert list(rewards) == [rewards_of[step] for _, rewards_of, _ in expected]
    assert ended.all()
    assert list(infos["score"]) == [info["score"] for *_, info in expected]
    # The next step starts the next episodes, whatever the action.
    observations, rewards, ended, _, infos = batch.step(np.ones((5, 1)))
    assert not ended.any() and not rewards.any() and not infos
    sixth, _ = single.reset(seed=4, options={"number": 5})
    np.testing.assert_array_equal(observations[0], sixth)


def test_an_open_valve_aborts_the_episode_and_costs_what_is_left():
    environment = eupnea.PressureControl(hold=10)
    _, rewards, info = roll_out(environment, 1.0, seed=1, options={"pip": 20.0})
    assert info["fault"] == "HighPressure" and len(rewards) < environment.steps
    missing = environment.steps - len(rewards)
    assert rewards[-1] <= -30.0 * missing


def test_without_monitors_nothing_is_aborted():
    _, rewards, info = roll_out(eupnea.PressureControl(monitors=False), 1.0, seed=1)
    assert info["fault"] is None and rewards.min() < -30


def test_rewards_can_count_effort_and_overshoot():
    plain = roll_out(eupnea.PressureControl(hold=1), -0.2, seed=1, options={"pip": 10.0})[1]
    effort = roll_out(eupnea.PressureControl(hold=1, effort=0.5), -0.2, seed=1, options={"pip": 10.0})[1]
    over = roll_out(eupnea.PressureControl(hold=1, overshoot=2.0), -0.2, seed=1, options={"pip": 10.0})[1]
    # Only the first command differs from the one before.
    assert effort[0] == pytest.approx(plain[0] - 0.5 * 40.0)
    np.testing.assert_array_equal(effort[1:], plain[1:])
    assert (over <= plain).all() and (over < plain).any()


def test_a_picture_shows_the_inspiration():
    environment = eupnea.PressureControl(render_mode="rgb_array")
    roll_out(environment, -0.6, seed=1)
    image = environment.render()
    assert image.shape == (240, 480, 3) and image.dtype == np.uint8
    assert (image == (31, 119, 180)).all(axis=-1).sum() > 300, "the curve of the pressure"


def test_wrong_options_and_actions_are_refused_with_what_is_right(environment):
    for options, text in [
        ({"lungs": "R0"}, "R0"),
        ({"lungs": []}, "no plant"),
        ({"pips": []}, "no PIP"),
        ({"prescriptions": "aliens"}, "no prescriptions aliens"),
        ({"prescriptions": "bedside", "pips": [20]}, "leave these out"),
        ({"observation": "nothing"}, "choose ours"),
        ({"action": "wish"}, "choose valve"),
        ({"hold": 0}, "hold is 0"),
        ({"breaths": 0}, "breaths is 0"),
        ({"family": "adult", "lungs": "paper"}, "choose one"),
        ({"effort": float("nan")}, "reward"),
        ({"render_mode": "human"}, "rgb_array"),
    ]:
        with pytest.raises(ValueError, match=text):
            eupnea.PressureControl(**options)
    with pytest.raises(RuntimeError, match="reset"):
        environment.step(0.0)
    environment.reset(seed=1)
    for action in [float("nan"), np.array([np.inf]), np.zeros(3), "open", None]:
        with pytest.raises(ValueError, match="action"):
            environment.step(action)
    with pytest.raises(ValueError, match="'bad'"):
        environment.reset(options={"bad": 1})
    environment.close()
    for call in (environment.reset, lambda: environment.step(0.0)):
        with pytest.raises(RuntimeError, match="closed"):
            call()


def test_a_batch_refuses_what_does_not_fit_and_moves_nothing():
    batch = eupnea.vector("eupnea/OneLung-v0", num_envs=3)
    batch.reset(seed=1)
    for actions in [np.zeros(2), np.zeros((3, 2)), np.array([0.0, np.nan, 0.0]), "open", None]:
        with pytest.raises(ValueError, match=r"action"):
            batch.step(actions)
    second, *_ = batch.step(np.zeros((3, 1)))
    again = eupnea.vector("eupnea/OneLung-v0", num_envs=3)
    again.reset(seed=1)
    np.testing.assert_array_equal(again.step(np.zeros((3, 1)))[0], second)
    for wrong in [{"num_envs": 0}, {"num_envs": 2, "threads": 0}]:
        with pytest.raises(ValueError, match="must be"):
            eupnea.vector("eupnea/OneLung-v0", **wrong)
    with pytest.raises(ValueError, match="choose from"):
        eupnea.vector("eupnea/Nothing-v0", 2)
    batch.close()
    with pytest.raises(RuntimeError, match="closed"):
        batch.step(np.zeros((3, 1)))


def test_gymnasium_makes_a_vector_of_its_own():
    batch = gymnasium.make_vec("eupnea/NineLungs-v0", num_envs=4, vectorization_mode="vector_entry_point")
    observations, _ = batch.reset(seed=2)
    assert observations.shape == (4, 25)
    assert batch.step(batch.action_space.sample())[0].shape == (4, 25)


def test_a_score_is_that_of_its_episodes():
    result = eupnea.score(lambda _: -0.6, episodes=3, hold=20)
    environment = eupnea.PressureControl(hold=20)
    infos = [roll_out(environment, -0.6, seed=1000, options={"number": n})[2] for n in range(3)]
    assert result["score"] == pytest.approx(np.mean([info["score"] for info in infos]))
    assert result["aborted"] == 0.0


def test_a_score_tells_the_policy_the_rise_of_every_episode():
    class Listener:
        rises = ()

        def start(self, rise_time):
            self.rises += (rise_time,)

        def __call__(self, seen):
            return -0.6

    policy = Listener()
    eupnea.score(policy, episodes=12, hold=100, prescriptions="bedside")
    assert len(policy.rises) == 12 and 0.0 in policy.rises and 0.05 <= max(policy.rises) <= 0.4
