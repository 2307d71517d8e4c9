"""`eairl bench`: what an iteration costs beside the simulation in it. Ratios of one run; machines are noisy."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.table import Table

from eairl_jax import Lanes, actor, discriminator, empowerment, make_irl, optimize
from eairl_jax.artefact import write_json
from eairl_jax.methods import resolve
from eairl_jax.ppo import ppo
from eairl_jax.types import PyTree, no_penalty
from experiments.folder import machine
from experiments.imitate import Job, prepare
from experiments.summary import peak_memory_gb
from experiments.training import console, seed_keys

SEEDS = 5
ROUNDS = 7


def command(task: str, methods: tuple[str, ...], forms: tuple[str, ...], json_path: Path | None,
            assignments: tuple[str, ...], iterations: int, line: str) -> None:  # fmt: skip
    """Measures every job of `eairl bench`, prints a table for each and writes all figures as JSON."""
    jobs = prepare(task, methods, forms, SEEDS, None, "reward", assignments)
    results = {"command": line, "task": task, "machine": machine(), "rows": {}}
    for job in jobs:
        with console.status(f"{job.row} in {task}: measuring"):
            results["rows"][job.row] = measure(job, iterations)
        _print(job, results["rows"][job.row])
    if json_path:
        json_path.parent.mkdir(parents=True, exist_ok=True)
        write_json(json_path, results)


def measure(job: Job, iterations: int) -> dict:
    """All figures of one job; every time is the median over interleaved rounds, in seconds an iteration."""
    config, hparams = job.recipe.config, job.recipe.hparams
    env, method = job.env, resolve(config)
    algorithm = make_irl(env, config)
    optimizer = ppo(env.observation_size, env.action_size, config)
    device = jax.devices()[:1]

    programs, compile_seconds = {}, {}
    for seeds, devices in ((1, device), (SEEDS, jax.devices())):
        lanes = Lanes(algorithm, seed_keys(seeds), hparams, job.demos, devices=devices)
        state = lanes.init()
        compile_seconds[seeds] = lanes.compile(state, iterations)
        programs[seeds] = [lanes, state]

    def iteration(seeds: int) -> Callable[[], None]:
        def run():
            lanes, state = programs[seeds]
            programs[seeds][1], _ = lanes.run(state, iterations)

        return run

    one = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), programs[1][0].take(programs[1][1]))
    _, raw = jax.jit(lambda key, acting: actor.collect(key, acting, env, optimizer, config))(one.key, one.actor)
    tau = actor.normalized(one.actor, raw)
    count = (2, config.discriminator_updates, config.discriminator_batch)
    drawn = optimize.draw(one.key, tau, *count)
    pair = discriminator.Samples(drawn.obs, drawn.action, drawn.next_obs, drawn.terminated, drawn.log_prob,
                                 jnp.zeros_like(drawn.log_prob))  # fmt: skip

    def collect(key, acting):
        return actor.collect(key, acting, env, optimizer, config)[0]

    stages: dict[str, Callable[[], None]] = {
        "simulation alone": _repeat(
            lambda key, state: simulate(key, state, env, config), one.actor.rollout.env, iterations
        ),
        "rollout": _repeat(collect, one.actor, iterations),
        "discriminator": _repeat(
            lambda key, d: discriminator.fit(d, pair, pair, hparams, method, config)[0], one.discriminator, iterations
        ),
        "policy": _repeat(
            lambda key, pi: optimizer.update(key, pi, tau, no_penalty, (), hparams)[0], one.actor.policy, iterations
        ),
    }
    if method.empowerment:
        stages["empowerment"] = _repeat(
            lambda key, emp: empowerment.fit(key, emp, tau, hparams, config)[0], one.empowerment, iterations
        )
    stages |= {"iteration": iteration(1), "iteration, five seeds": iteration(SEEDS)}
    seconds = _time(stages, iterations)
    steps = config.steps_per_iteration
    return {
        "env_steps_per_iteration": steps,
        "milliseconds": {name: 1e3 * s for name, s in seconds.items()},
        "simulation_steps_per_second": steps / seconds["simulation alone"],
        "iteration_steps_per_second": steps / seconds["iteration"],
        "iteration_over_simulation": seconds["simulation alone"] / seconds["iteration"],
        "five_seeds_over_one": seconds["iteration, five seeds"] / seconds["iteration"],
        "compile_seconds": {str(seeds): s for seeds, s in compile_seconds.items()},
        "peak_memory_gb": peak_memory_gb(),
        "config": dataclasses.asdict(config),
    }


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


def _time(programs: dict[str, Callable[[], None]], iterations: int) -> dict[str, float]:
    """Median seconds an iteration of each program; rounds are interleaved, so that noise meets all alike."""
    for run in programs.values():
        run()
    taken: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(ROUNDS):
        for name, run in programs.items():
            started = time.perf_counter()
            run()
            taken[name].append((time.perf_counter() - started) / iterations)
    return {name: float(np.median(seconds)) for name, seconds in taken.items()}


def _print(job: Job, result: dict) -> None:
    milliseconds = result["milliseconds"]
    title = f"{job.row} in {job.task}: {result['env_steps_per_iteration']:,} env steps an iteration, one seed"
    table = Table(title=title, title_justify="left")
    for name, justify in (("stage", "left"), ("ms", "right"), ("env steps/s", "right"), ("share", "right")):
        table.add_column(name, justify=justify)  # pyright: ignore
    for name, ms in milliseconds.items():
        steps = result["env_steps_per_iteration"] * (SEEDS if "five" in name else 1)
        share = f"{ms / milliseconds['iteration']:.0%}" if "five" not in name else ""
        table.add_row(name, f"{ms:.1f}", f"{1e3 * steps / ms:,.0f}", share)
    console.print(table)
    console.print(
        f"whole iteration over simulation alone: {result['iteration_over_simulation']:.2f} (target 0.5)\n"
        f"five seeds over one: {result['five_seeds_over_one']:.2f} x the time, {len(jax.devices())} devices (aim 4)\n"
        f"compile: {result['compile_seconds']['1']:.1f} s one seed, {result['compile_seconds'][str(SEEDS)]:.1f} s five "
        f"(seconds only, where the persistent cache is warm); peak memory {result['peak_memory_gb']:.1f} GB"
    )
