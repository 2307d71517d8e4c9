"""`eairl bench`: what an iteration costs beside the simulation in it. Ratios of one run; machines are noisy."""

from __future__ import annotations

import dataclasses
import itertools
import os
import time
from collections.abc import Callable, Sequence

import jax
import mujoco
import mujoco.rollout
import numpy as np
from rich.text import Text

from eairl_jax import (
    Algorithm,
    HParams,
    InputError,
    Lanes,
    agent,
    discriminator,
    discriminator_data,
    empowerment,
    horizon,
    make_irl,
    replay,
    rollout,
)
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.display.console import console, print_rows
from eairl_jax.experiments.display.plots import Scale, plot_scaling
from eairl_jax.experiments.options import Bench
from eairl_jax.experiments.pipeline import scaling
from eairl_jax.experiments.pipeline.experiment import Experiment, imitations
from eairl_jax.experiments.pipeline.run_folder import check_writable, machine, peak_memory_gb
from eairl_jax.experiments.pipeline.stages import learner
from eairl_jax.experiments.pipeline.train import LEARN, lane_keys
from eairl_jax.lanes import shards_for
from eairl_jax.methods import METHODS, with_method_defaults
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.storage import write_json
from eairl_jax.types import Key, PyTree, no_penalty

SEEDS = 5
ONE_DEVICE, FIVE_SEEDS, ALL_DEVICES = "iteration", "iteration, five seeds", "iteration, all devices"
"""Programs of whole iterations: one seed on one device, five seeds on all devices, one seed on all devices."""
ROUNDS = 7


def run(options: Bench, command_line: str) -> None:
    """Measures every experiment of `eairl bench`, prints a table for each and writes all figures as JSON."""
    experiments, task, iterations = imitations(options, "reward"), options.task, options.iterations
    if iterations < 1:
        raise InputError(f"--iterations {iterations}: expected at least 1")
    for experiment in experiments:
        if not experiment.has_reward:
            raise InputError(f"{experiment.name} is not adversarial: bench measures {', '.join(METHODS)}")
    for path in filter(None, (options.json, options.figure)):
        check_writable(path)
    if options.scale:
        return _scale(options, experiments, command_line)
    if options.figure:
        raise InputError("--figure is of --scale: name what is varied, for example --scale num_envs=16,64,256")
    with console.status(Text(f"{task}: compiling and measuring")):
        results, simulation = measure(experiments, iterations)
    for experiment in experiments:
        _print(experiment, results[experiment.name])
    if len(experiments) > 1:
        _compare(task, results)
    in_c = ""
    if "mjx_over_c" in simulation:
        c, ratio = simulation["c_steps_per_second"], simulation["mjx_over_c"]
        in_c = f", the C engine (mujoco.rollout, {simulation['threads']} threads) {c:,.0f}; MJX over C {ratio:.2f}"
    console.print(
        f"random actions, {simulation['envs']} environments: {'MJX' if in_c else 'JAX'} on {simulation['devices']} "
        f"devices {simulation['mjx_steps_per_second']:,.0f} env steps/s{in_c}\n"
        f"peak memory of all measurements {simulation['peak_memory_gb']:.1f} GB"
    )
    if options.json:
        content = {"command_line": command_line, "task": task, "machine": machine()}
        write_json(options.json, content | {"methods": results, "simulation": simulation})


def _scale(options: Bench, experiments: list[Experiment], command_line: str) -> None:
    """`--scale`: measures along each axis, prints a table and a law for each, and writes what is asked for."""
    if len(experiments) > 1:
        raise InputError("--scale measures one method: name one --method and one --reward-form")

    def make(settings: Sequence[str]) -> Experiment:
        return imitations(dataclasses.replace(options, set=(*options.set, *settings)), "reward")[0]

    axes = [scaling.axis(text) for text in options.scale]
    planned = [scaling.experiments(axis, make) for axis in axes]
    for experiment in itertools.chain(*planned):  # before the first of them is measured
        learner(experiment)[1].check_memory()
    panels, content = [], {}
    for axis, along in zip(axes, planned, strict=True):
        points = []
        for value, experiment in zip(axis.values, along, strict=True):
            with console.status(Text(f"{options.task}: {axis.name} = {value}")):
                points.append(scaling.measured(value, experiment, options.iterations))
        law = scaling.fitted(axis.values, [point.seconds for point in points])
        _print_scale(options.task, axis, points, law)
        content[axis.name] = {"points": [point._asdict() for point in points], "law": law._asdict()}
        times = np.array([point.seconds for point in points])
        panels.append(Scale(axis.name, np.array(axis.values), times, law.fixed, law.each))
    if options.json:
        write_json(options.json, {"command_line": command_line, "task": options.task, "machine": machine(), **content})
    if options.figure:
        plot_scaling(options.figure, f"{experiments[0].name} in {options.task}: time of an iteration", panels)


def _print_scale(task: str, axis: scaling.Axis, points: list[scaling.Point], law: scaling.Law) -> None:
    rows = [
        [
            f"{point.value:,}",
            f"{1e3 * point.seconds:,.1f}",
            f"{point.env_steps / point.seconds:,.0f}",
            f"{point.states_gb:.3f}",
            f"{point.beside_gb:.3f}",
            f"{point.compile_seconds:.1f}",
        ]
        for point in points
    ]
    titles = [axis.name, "ms", "env steps/s", "states, GB", "beside, GB", "compile, s"]
    print_rows(f"{task}: {axis.name}", titles, rows)
    console.print(
        f"an iteration takes {1e3 * law.fixed:.3g} ms + {1e3 * law.each:.3g} ms x {axis.name}; the largest deviation "
        f"is {law.deviation:.0%}"
    )


def measure(experiments: list[Experiment], iterations: int) -> tuple[dict[str, dict], dict[str, float]]:
    """All figures of every experiment, and of the simulation in the two engines.

    Times are medians over rounds in which everything takes turns, seconds an iteration.
    """
    programs: dict[tuple[str, str], Callable[[], None]] = {}
    compiled = {}
    for experiment in experiments:
        runs, compiled[experiment.name] = whole_iterations(experiment, iterations)
        for name, run in (stages(experiment, iterations) | runs).items():
            programs[experiment.name, name] = run
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for name, run in engines(experiments[0], iterations, threads).items():
        programs["engines", name] = run
    seconds = _time(programs, iterations)
    results = {}
    for experiment in experiments:
        own = {name: s for (row, name), s in seconds.items() if row == experiment.name}
        steps = experiment.recipe.config.steps_per_iteration
        results[experiment.name] = {
            "env_steps_per_iteration": steps,
            "milliseconds": {name: 1e3 * s for name, s in own.items()},
            "simulation_steps_per_second": steps / own["simulation alone"],
            "iteration_steps_per_second": steps / own[ONE_DEVICE],
            "iteration_over_simulation": own["simulation alone"] / own[ONE_DEVICE],
            "five_seeds_over_one": own[FIVE_SEEDS] / own[ONE_DEVICE],
            **({"speedup_of_all_devices": own[ONE_DEVICE] / own[ALL_DEVICES]} if ALL_DEVICES in own else {}),
            "compile_seconds": compiled[experiment.name],
            "config": dataclasses.asdict(experiment.recipe.config),
        }
    config, devices = experiments[0].recipe.config, len(jax.devices())
    steps = config.steps_per_iteration * devices
    mjx, c = seconds["engines", "MJX"], seconds.get(("engines", "C"))
    simulation = {
        "envs": config.num_envs * devices,
        "devices": devices,
        "threads": threads,
        "mjx_steps_per_second": steps / mjx,
        **({"c_steps_per_second": steps / c, "mjx_over_c": c / mjx} if c else {}),
        "peak_memory_gb": peak_memory_gb(),
    }
    return results, simulation


def whole_iterations(experiment: Experiment, iterations: int) -> tuple[dict[str, Callable[[], None]], dict[str, float]]:
    """Programs of whole iterations, and what compiling them took.

    They are those of one seed on one device, of five seeds on all devices and, if there are several, of one on all.
    """
    config, runs, compile_seconds = experiment.recipe.config, {}, {}

    def program(lanes: Lanes, state: PyTree) -> Callable[[], None]:
        held = [state]  # a chunk consumes the state it is given

        def run():
            held[0], _ = lanes.run(held[0], iterations)

        return run

    devices, shards = jax.local_devices(), shards_for(1, config)
    programs = {ONE_DEVICE: (1, devices[:1], 1), FIVE_SEEDS: (SEEDS, devices, 1)}
    if shards > 1:
        programs[ALL_DEVICES] = (1, devices, shards)
    for name, (seeds, used, per_lane) in programs.items():
        lanes = Lanes(
            make_irl(experiment.source.env, config, per_lane),
            lane_keys(LEARN, range(seeds)),
            experiment.recipe.hparams,
            experiment.source.demos,
            devices=used,
        )
        state = lanes.init()
        compile_seconds[name] = lanes.compile(state, iterations)
        runs[name] = program(lanes, state)
    return runs, compile_seconds


def stages(experiment: Experiment, iterations: int) -> dict[str, Callable[[], None]]:
    """A program for each stage of an iteration of one seed, and one for the simulation in it alone."""
    config, hparams, env = (
        with_method_defaults(horizon.learning_config(experiment.source.env, experiment.recipe.config)),
        experiment.recipe.hparams,
        experiment.source.env,
    )
    algorithm, env = make_irl(env, config), horizon.learning_env(env, config)
    optimizer = make_optimizer(env, config)
    state = jax.jit(algorithm.init)(jax.random.PRNGKey(0), hparams)
    acting, raw = jax.jit(lambda s: agent.collect(s.key, s.agent, env, optimizer, config))(state)
    past, tau = replay.add(jax.random.PRNGKey(0), state.replay, raw, config), agent.normalize_obs(acting, raw)

    def pi(obs):
        return optimizer.distribution(acting.policy, obs)

    def discriminate(key, d):
        drawn = discriminator_data.draw_minibatches(
            key, agent.clip_actions(experiment.source.demos, env, config), past, raw, hparams, config
        )
        pair = (
            discriminator_data.for_loss(x, pi, state.empowerment, state.exact_phi, acting, hparams, config)
            for x in drawn
        )
        expert, policy = pair
        return discriminator.fit(d, expert, policy, hparams, config)[0]

    programs = {
        "simulation alone": (lambda key, s: simulate(key, s, env, config), acting.rollout.env),
        "rollout": (lambda key, a: agent.collect(key, a, env, optimizer, config)[0], acting),
        "discriminator": (discriminate, state.discriminator),
        "policy": (lambda key, p: optimizer.update(key, p, tau, no_penalty, (), hparams)[0], acting.policy),
    }
    if state.empowerment:
        programs["empowerment"] = (
            lambda key, emp: empowerment.fit(key, emp, tau, pi, hparams, config, env.action_limit)[0],
            state.empowerment,
        )
    return {name: _repeat(stage, start, iterations) for name, (stage, start) in programs.items()}


def engines(experiment: Experiment, iterations: int, threads: int) -> dict[str, Callable[[], None]]:
    """The same simulation, uniformly random actions, by MJX on every device and by `mujoco.rollout` on every core.

    Only an `MjxTask` has the second.
    """
    env, config, devices = experiment.source.env, experiment.recipe.config, len(jax.devices())
    keys = jax.random.split(jax.random.PRNGKey(0), devices)

    def start(key, _):
        return key, rollout.reset(key, env, config.num_envs, config.rollout_length, config.episode_length).env

    def step(carry, _, __):
        key, state = carry
        key, own = jax.random.split(key)
        return (key, simulate(own, state, env, config)), {}

    lanes = Lanes(Algorithm(start, step, lambda *_: None), keys, HParams())
    lanes.compile(lanes.init(), iterations)
    programs = {"MJX": lambda: jax.block_until_ready(lanes.run(lanes.init(), iterations)[0])}
    if isinstance(env, MjxTask):
        programs["C"] = _in_c_engine(env, experiment, keys[0], iterations, threads)
    return programs


def _in_c_engine(env: MjxTask, experiment: Experiment, key: Key, iterations: int, threads: int) -> Callable[[], None]:
    """The simulation by `mujoco.rollout` on every core."""
    config, devices = experiment.recipe.config, len(jax.devices())
    starts = jax.vmap(env.initial)(jax.random.split(key, config.num_envs * devices))
    data, full = mujoco.MjData(env.model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = []
    for qpos, qvel in zip(*map(np.asarray, starts), strict=True):
        data.qpos[:], data.qvel[:] = qpos, qvel
        states.append(np.zeros(mujoco.mj_stateSize(env.model, full)))
        mujoco.mj_getState(env.model, data, states[-1], full)
    shape = (len(states), config.rollout_length, env.action_size)
    actions = np.random.default_rng(0).uniform(-env.action_limit, env.action_limit, shape)
    actions, pool = np.repeat(actions, env.frame_skip, axis=1), mujoco.rollout.Rollout(nthread=threads)
    copies = [mujoco.MjData(env.model) for _ in range(threads)]

    def in_c() -> None:
        now = np.array(states)
        for _ in range(iterations):  # one at a time: it returns whole trajectories
            trajectories, _ = pool.rollout(env.model, copies, now, actions)
            now = np.asarray(trajectories)[:, -1].copy()

    return in_c


def simulate(key: jax.Array, state: PyTree, env, config) -> PyTree:
    """The simulation of one iteration alone: the same environments and batch, uniformly random actions."""
    shape = (config.rollout_length, config.num_envs, env.action_size)
    actions = jax.random.uniform(key, shape, minval=-env.action_limit, maxval=env.action_limit)
    state, observed = jax.lax.scan(lambda s, a: (jax.vmap(env.step)(s, a), s.obs), state, actions)
    return state.replace(reward=state.reward + 0.0 * observed.sum())  # observations must not be optimised away


def _repeat(stage: Callable[[jax.Array, PyTree], PyTree], state: PyTree, iterations: int) -> Callable[[], None]:
    """A program that runs a stage `iterations` times in one scan, each on the result of the one before."""
    keys = jax.random.split(jax.random.PRNGKey(0), iterations)
    program = jax.jit(lambda state: jax.lax.scan(lambda s, key: (stage(key, s), None), state, keys)[0])
    return lambda: jax.block_until_ready(program(state))


def _time(programs: dict, iterations: int) -> dict:
    """Median seconds an iteration of each program; rounds are interleaved, so that noise meets all alike."""
    for run in programs.values():
        run()
    taken: dict[tuple[str, str], list[float]] = {name: [] for name in programs}
    for _ in range(ROUNDS):
        for name, run in programs.items():
            started = time.perf_counter()
            run()
            taken[name].append((time.perf_counter() - started) / iterations)
    return {name: float(np.median(seconds)) for name, seconds in taken.items()}


def _print(experiment: Experiment, result: dict) -> None:
    milliseconds = result["milliseconds"]
    steps = result["env_steps_per_iteration"]
    title = f"{experiment.name} in {experiment.source.task}: {steps:,} env steps an iteration, one seed"
    rows = []
    for name, ms in milliseconds.items():
        steps = result["env_steps_per_iteration"] * (SEEDS if name == FIVE_SEEDS else 1)
        share = f"{ms / milliseconds[ONE_DEVICE]:.0%}" if name != FIVE_SEEDS else ""
        rows.append([name, f"{ms:.1f}", f"{1e3 * steps / ms:,.0f}", share])
    print_rows(title, ["stage", "ms", "env steps/s", "share"], rows)
    devices, seconds = len(jax.local_devices()), result["compile_seconds"]
    speedup = result.get("speedup_of_all_devices")
    alone = f"one seed on {devices} devices: {speedup:.2f} x the speed of one device\n" if speedup else ""
    console.print(
        f"speed of a whole iteration over that of simulation alone: {result['iteration_over_simulation']:.2f}\n"
        f"five seeds on {devices} devices: {result['five_seeds_over_one']:.2f} x the time of one seed on one device\n"
        f"{alone}compile: {seconds[ONE_DEVICE]:.1f} s one seed, {seconds[FIVE_SEEDS]:.1f} s five "
        "(seconds only, where the persistent cache is warm)"
    )


def _compare(task: str, results: dict[str, dict]) -> None:
    first = next(iter(results))
    base, rows = results[first]["milliseconds"][ONE_DEVICE], []
    for row, result in results.items():
        ms = result["milliseconds"][ONE_DEVICE]
        rows.append([row, f"{ms:.1f}", f"{result['iteration_over_simulation']:.2f}", f"{ms / base:.2f}"])
    titles = ["", "ms", "speed over simulation", f"time over {first}"]
    print_rows(f"Iterations in {task}, one seed, measured in turns", titles, rows)
