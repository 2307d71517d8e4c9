"""Bugs that a programmer could write, and the tests that must fail on each of them.

A bug is a text that stands exactly once in a file, and the text that takes its place. `run.py` plants the bugs.
"""

from __future__ import annotations

from typing import NamedTuple


class Bug(NamedTuple):
    """A wrong line.

    Attributes:
      name: of the bug, for `--only`.
      file: that holds the line, from the root of the repository.
      right: a text that stands exactly once in the file.
      wrong: the text that takes its place. The file can still be imported.
      tests: files under `tests/`, or tests in them, of which at least one must fail.
    """

    name: str
    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]


def bugs_of(folder: str, *rows: tuple[str, ...]) -> list[Bug]:
    """Bugs `(name, file in the folder, right, wrong, *tests)`."""
    return [Bug(name, f"{folder}/{file}", right, wrong, tests) for name, file, right, wrong, *tests in rows]


LIBRARY = bugs_of(
    "eairl_jax",
    (
        "airl-adds-log-pi",
        "methods.py",
        "return f - log_prob",
        "return f + log_prob",
        "eairl_jax/test_methods.py",
    ),
    (
        "gail-reward-of-the-other-sign",
        "methods.py",
        "return jax.nn.softplus(logit)",
        "return -jax.nn.softplus(-logit)",
        "eairl_jax/test_methods.py",
    ),
    (
        "labels-swapped",
        "methods.py",
        "softplus(-expert_logit).mean() + jax.nn.softplus(policy_logit)",
        "softplus(expert_logit).mean() + jax.nn.softplus(-policy_logit)",
        "eairl_jax/test_discriminator.py",
    ),
    (
        "shaping-beyond-the-end",
        "discriminator.py",
        "return gamma * (1.0 - terminated) * next_potential - potential",
        "return gamma * next_potential - potential",
        "eairl_jax/test_discriminator.py",
    ),
    (
        "shaping-without-discount",
        "discriminator.py",
        "f += shaping(h, next_h, samples.terminated, discount)",
        "f += shaping(h, next_h, samples.terminated, 1.0)",
        "eairl_jax/test_discriminator.py",
    ),
    (
        "mean-logit-of-a-trajectory",
        "discriminator.py",
        "config).sum(axis=-1)\n",
        "config).mean(axis=-1)\n",
        "eairl_jax/test_discriminator.py",
    ),
    (
        "gradient-penalty-towards-0",
        "discriminator.py",
        "return jnp.mean((norm - 1.0) ** 2)",
        "return jnp.mean(norm**2)",
        "eairl_jax/test_discriminator.py",
    ),
    (
        "actions-pay",
        "discriminator.py",
        "return g - jax.nn.softplus(",
        "return g + jax.nn.softplus(",
        "eairl_jax/test_discriminator.py",
    ),
    (
        "gae-value-after-the-end",
        "gae.py",
        "delta = reward + gamma * (1.0 - terminated) * next_value - value",
        "delta = reward + gamma * next_value - value",
        "eairl_jax/test_gae.py",
    ),
    (
        "gae-across-time-limits",
        "gae.py",
        "carry_on = gamma * lambda_ * (1.0 - terminated) * (1.0 - truncated)",
        "carry_on = gamma * lambda_ * (1.0 - terminated)",
        "eairl_jax/test_gae.py",
    ),
    (
        "gae-lambda-alone",
        "gae.py",
        "carry_on = gamma * lambda_ *",
        "carry_on = lambda_ *",
        "eairl_jax/test_gae.py",
    ),
    (
        "ppo-optimistic-bound",
        "ppo.py",
        "-jnp.minimum(ratio * minibatch.advantage",
        "-jnp.maximum(ratio * minibatch.advantage",
        "eairl_jax/test_ppo.py",
    ),
    (
        "ppo-clipped-on-one-side",
        "ppo.py",
        "1.0 + hparams.clip_eps)",
        "1.0 + 10.0 * hparams.clip_eps)",
        "eairl_jax/test_ppo.py",
    ),
    (
        "ppo-gradient-not-clipped",  # the audit of November 2026 planted this bug, and no test failed
        "ppo.py",
        "gradient = train_state.clip_norm(gradient, hparams.max_grad_norm)",
        "gradient = jax.tree.map(lambda g: g, gradient)",
        "eairl_jax/test_ppo.py",
    ),
    (
        "ppo-penalty-pays",
        "ppo.py",
        "total = policy_loss + cost -",
        "total = policy_loss - cost -",
        "eairl_jax/test_ppo.py",
    ),
    (
        "return-runs-across-time-limits",  # not caught in November 2026
        "actor_critic.py",
        "batch.terminated + batch.truncated, hparams.gamma)",
        "batch.terminated, hparams.gamma)",
        "eairl_jax/test_actor_critic.py",
    ),
    (
        "advantage-not-centred",
        "actor_critic.py",
        "advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)",
        "advantage = advantage / (advantage.std() + 1e-8)",
        "eairl_jax/test_actor_critic.py",
        "eairl_jax/test_ppo.py",
    ),
    (
        "trpo-without-kl-limit",
        "trpo.py",
        "good = (loss < objective(theta)[0]) & (kl <= kl_limit)",
        "good = loss < objective(theta)[0]",
        "eairl_jax/test_trpo.py",
    ),
    (
        "trpo-short-step",
        "trpo.py",
        "jnp.sqrt(2.0 * hparams.kl_limit / curvature)",
        "jnp.sqrt(hparams.kl_limit / curvature)",
        "eairl_jax/test_trpo.py::test_the_step_is_the_natural_gradient",
    ),
    (
        "log-prob-without-scale",
        "gaussian.py",
        "return jnp.sum(-0.5 * z**2 - self.log_std -",
        "return jnp.sum(-0.5 * z**2 -",
        "eairl_jax/test_gaussian.py",
    ),
    (
        "entropy-of-half-a-nat-less",
        "gaussian.py",
        "0.5 * (1.0 + LOG_2PI)",
        "0.5 * LOG_2PI",
        "eairl_jax/test_gaussian.py",
    ),
    (
        "clipped-mass-of-one-bound",
        "gaussian.py",
        "jnp.sign(action) * self.mean - self.limit",
        "self.mean - self.limit",
        "eairl_jax/test_gaussian.py",
    ),
    (
        "clipped-entropy-of-the-wrong-density",
        "gaussian.py",
        "squared = inside + to_low",
        "squared = inside - to_low",
        "eairl_jax/test_gaussian.py",
    ),
    (
        "normaliser-divides-by-the-variance",
        "normalize.py",
        "jax.lax.rsqrt(stats.var + 1e-8)",
        "jax.lax.reciprocal(stats.var + 1e-8)",
        "eairl_jax/test_normalize.py",
    ),
    (
        "normaliser-forgets-the-drift",
        "normalize.py",
        "var * size + delta**2 * stats.count * size / total)",
        "var * size)",
        "eairl_jax/test_normalize.py",
    ),
    (
        "potential-adds-log-pi",
        "empowerment.py",
        "return beta * log_q - log_prob",
        "return beta * log_q + log_prob",
        "eairl_jax/test_empowerment.py",
    ),
    (
        "inverse-model-unlearns",
        "empowerment.py",
        "return -q.log_prob(action)",
        "return q.log_prob(action)",
        "eairl_jax/test_empowerment.py",
    ),
    (
        "phi-copied-off-the-beat",
        "empowerment.py",
        "config.phi_sync_interval == 0",
        "config.phi_sync_interval != 0",
        "eairl_jax/test_empowerment.py::test_the_slow_copy_follows_every_so_many_iterations",
    ),
    (
        "phi-of-the-old-inverse-model",
        "empowerment.py",
        "inverse.params, pi(x.obs), x, config, limit)",
        "state.inverse.params, pi(x.obs), x, config, limit)",
        "eairl_jax/test_irl.py::test_the_discriminators_loss_by_hand_with_log_pi_of_the_current_policy",
    ),
    (
        "fast-phi-in-the-loss",
        "discriminator_data.py",
        "emp.phi_target if emp else None",
        "emp.phi.params if emp else None",
        "eairl_jax/test_irl.py::test_no_gradient_of_the_discriminators_loss_reaches_phi",
        "eairl_jax/test_irl.py::test_the_shaping_by_phi_is_a_constant_of_the_phi_and_the_discount_asked_for",
    ),
    (
        "reward-of-the-old-discriminator",
        "irl.py",
        "discriminator.policy_reward(d.params, samples",
        "discriminator.policy_reward(state.discriminator.params, samples",
        "eairl_jax/test_irl.py::test_the_policys_reward_is_the_methods_by_the_networks_just_fitted",
    ),
    (
        "replay-of-one-iteration",
        "replay.py",
        "slot = replay.added % slots",
        "slot = replay.added % 1",
        "eairl_jax/test_replay.py",
    ),
    (
        "replay-never-new",
        "replay.py",
        "half = batch // 2",
        "half = batch",
        "eairl_jax/test_replay.py",
    ),
    (
        "segments-of-mixed-environments",
        "train_state.py",
        "(block * length + jnp.arange(length)) * num_envs + env",
        "(block * length + jnp.arange(length)) + num_envs * env",
        "eairl_jax/test_train_state.py",
    ),
    (
        "time-limit-a-step-late",
        "rollout.py",
        "truncated = (steps >= episode_length)",
        "truncated = (steps > episode_length)",
        "eairl_jax/test_rollout.py",
    ),
    (
        "absorbed-a-step-late",
        "horizon.py",
        "has_ended & (t >= length - 1)",
        "has_ended & (t >= length)",
        "eairl_jax/test_horizon.py::test_absorbing_steps_of_the_expert_are_those_of_the_policy",
    ),
    (
        "the-dead-are-paid",
        "horizon.py",
        "reward = jnp.where(state.ended > 0, 0.0, inner.reward)",
        "reward = inner.reward",
        "eairl_jax/test_horizon.py",
    ),
    (
        "one-absorbing-step-is-paid-as-one",
        "horizon.py",
        "return reward * jnp.where(alive(obs, config) > 0, 1.0, stay)",
        "return reward",
        "eairl_jax/test_rl.py::test_an_end_is_paid_for_all_absorbing_steps_and_the_temperature_for_none",
    ),
    (
        "the-shaping-ends-in-the-absorbing-state",
        "horizon.py",
        "return steps._replace(terminated=0.0 * steps.terminated) if",
        "return steps if",
        "eairl_jax/test_discriminator_data.py",
    ),
    (
        "statistics-of-the-absorbing-state",
        "horizon.py",
        "obs, weight=alive(obs, config))",
        "obs)",
        "eairl_jax/test_horizon.py::test_statistics_of_observations_leave_out_the_absorbing_state",
    ),
    (
        "plans-paid-after-their-end",
        "plans.py",
        "return jnp.where(transitions.truncated > 0, 0.0, reward(transitions)).mean(axis=0)",
        "return reward(transitions).mean(axis=0)",
        "eairl_jax/test_plans.py",
    ),
    (
        "temperature-costs-entropy",
        "rl.py",
        "rewards - hparams.temperature * log_prob",
        "rewards + hparams.temperature * log_prob",
        "eairl_jax/test_rl.py",
    ),
    (
        "any-termination-in-demonstrations",
        "demonstrations.py",
        "early = (demos.terminated > 0) & ~last",
        "early = (demos.terminated > 1) & ~last",
        "eairl_jax/test_demonstrations.py",
    ),
    (
        "evaluation-pays-the-dead",
        "evaluation.py",
        '"reward": jnp.where(alive > 0, state.reward, 0.0),',
        '"reward": state.reward,',
        "eairl_jax/test_evaluation.py",
    ),
    (
        "late-episodes-counted",
        "rollout.py",
        "returns = jnp.where(steps > 0, UNKNOWN, jnp.zeros(num_envs))",
        "returns = jnp.zeros(num_envs)",
        "eairl_jax/test_rollout.py",
    ),
    (
        "reservoir-never-filled",
        "replay.py",
        "jnp.where(replay.added < slots, replay.added, drawn)",
        "drawn",
        "eairl_jax/test_replay.py",
    ),
    (
        "clone-keeps-adams-moments",
        "plans.py",
        "nets=train_state.init(fitted.params)",
        "nets=fitted",
        "eairl_jax/test_plans.py",
    ),
    (
        "clone-sees-raw-observations",
        "plans.py",
        "samples = normalize.normalize(before.obs_stats, obs), action, weight",
        "samples = obs, action, weight",
        "eairl_jax/test_plans.py",
    ),
    (
        "clone-learns-after-the-end",
        "plans.py",
        "(raw.obs, raw.action, 1.0 - raw.truncated)",
        "(raw.obs, raw.action, 1.0 - 0.0 * raw.truncated)",
        "eairl_jax/test_plans.py",
    ),
    (
        "std-begins-elsewhere",
        "nets.py",
        "steepness * raw + math.log(part / (1.0 - part))",
        "steepness * raw",
        "eairl_jax/test_nets.py",
    ),
    (
        "expert-beyond-the-bounds",
        "irl.py",
        "demonstrated = agent.clip_actions(demos, env, config)",
        "demonstrated = demos",
        "eairl_jax/test_irl.py::test_of_executed_actions_the_part_beyond_the_bound_has_no_effect",
    ),
    (
        "phi-copied-an-iteration-late",
        "irl.py",
        "empowerment.sync(emp, acting.iteration, config)",
        "empowerment.sync(emp, state.agent.iteration, config)",
        "eairl_jax/test_irl.py::test_the_slow_phi_is_copied_after_every_so_many_whole_iterations",
    ),
    (
        "anneals-across-resets",
        "agent.py",
        "agent.iteration % iterations if config",
        "agent.iteration if config",
        "eairl_jax/test_irl.py::test_a_policy_starts_anew_and_its_reward_does_not",
        "eairl_jax/test_agent.py",
    ),
    (
        "temperature-in-the-absorbing-state",
        "rl.py",
        "raw.log_prob * horizon.alive(raw.obs, config)",
        "raw.log_prob",
        "eairl_jax/test_rl.py::test_an_end_is_paid_for_all_absorbing_steps_and_the_temperature_for_none",
    ),
    (
        "log-pi-in-the-absorbing-state",
        "discriminator_data.py",
        "log_prob * horizon.alive(raw.obs, config)",
        "log_prob",
        "eairl_jax/test_discriminator_data.py",
    ),
    (
        "actions-in-the-absorbing-state",
        "horizon.py",
        "return action * (1.0 - obs[..., -1:]) if",
        "return action if",
        "eairl_jax/test_horizon.py",
    ),
    (
        "scale-of-rewards-starts-slowly",
        "actor_critic.py",
        "weight = jnp.maximum(1.0 / count, 1.0 - RETURN_VAR_DECAY)",
        "weight = 1.0 - RETURN_VAR_DECAY",
        "eairl_jax/test_actor_critic.py",
    ),
    (
        "nan-is-no-number-to-worry-about",
        "lanes.py",
        'name == "true_return" else ~np.isfinite(values)',
        'name == "true_return" else np.isinf(values)',
        "eairl_jax/test_lanes.py",
        "experiments/pipeline/test_train.py::test_nan_stops_the_run_and_keeps_the_last_good_checkpoint",
    ),
    (
        "damaged-checkpoint-believed",
        "checkpoint.py",
        "return written == _digest(folder)",
        "return bool(written)",
        "eairl_jax/test_checkpoint.py",
        "experiments/pipeline/test_train.py::test_a_damaged_checkpoint_is_made_again",
    ),
    (
        "critic-prefers-the-policy",
        "methods.py",
        "return policy_logit.mean() - expert_logit.mean()",
        "return expert_logit.mean() - policy_logit.mean()",
        "eairl_jax/test_methods.py",
    ),
    (
        "end-paid-without-discount",
        "gymnasium.py",
        "gamma / (1.0 - gamma) * self._reward.after_end()",
        "1.0 / (1.0 - gamma) * self._reward.after_end()",
        "eairl_jax/test_gymnasium.py",
    ),
    (
        "paid-by-the-observation-after",
        "gymnasium.py",
        "learned = float(self._pay(self._obs, action, terminated))",
        "learned = float(self._pay(obs, action, terminated))",
        "eairl_jax/test_gymnasium.py",
    ),
    (
        "exported-reward-not-clipped",
        "saved_reward.py",
        "action if limit is None else jnp.clip(action, -limit, limit)",
        "action",
        "eairl_jax/test_exported.py",
    ),
    (
        "numpy-policy-of-another-std",
        "numpy_nets.py",
        "action = action + std * rng",
        "action = action + std**2 * rng",
        "eairl_jax/test_saved_policy.py",
    ),
)

FAST_STEPS = "envs/test_locomotion.py::test_fast_steps_are_the_c_engines_on_the_same_model"
EXACT_STEPS = "envs/test_locomotion.py::test_exact_steps_and_rewards_are_gymnasiums"
ACCELERATIONS = "envs/physics/test_contact_solver.py::test_accelerations_are_the_c_engines"

PHYSICS = bugs_of(
    "envs",
    (
        "actions-without-bounds",
        "mjx_task.py",
        "action = jnp.clip(action, -self.action_limit, self.action_limit)",
        "action = jnp.asarray(action)",
        "envs/test_swimmer.py",
    ),
    (
        "explicit-damping",
        "locomotion.py",
        "self.model.opt.timestep * damped",
        "self.model.opt.timestep * qacc",
        f"{FAST_STEPS}[half_cheetah]",
    ),
    (
        "runge-kutta-of-equal-weights",
        "locomotion.py",
        "jnp.array([1.0, 2.0, 2.0, 1.0]) / 6",
        "jnp.array([1.0, 1.0, 1.0, 1.0]) / 4",
        f"{EXACT_STEPS}[swimmer]",
    ),
    (
        "effort-pays",
        "locomotion.py",
        "return velocity - self.control_cost",
        "return velocity + self.control_cost",
        "envs/test_swimmer.py",
        "envs/test_ant.py",
    ),
    (
        "angular-velocity-in-the-wrong-frame",
        "locomotion.py",
        "jnp.cross(b, v)",
        "jnp.cross(v, b)",
        f"{FAST_STEPS}[crippled_ant]",
    ),
    (
        "friction-pyramid-of-three-edges",
        "physics/contact_solver.py",
        "normal + second, normal - second])",
        "normal + second, normal + second])",
        f"{ACCELERATIONS}[crippled_ant]",
    ),
    (
        "upper-limits-pull",
        "physics/contact_solver.py",
        "rows.limit_sign * limit_pushing * limit_slack",
        "limit_pushing * limit_slack",
        f"{ACCELERATIONS}[swimmer]",
    ),
    (
        "contacts-damped-by-half",
        "physics/contact_solver.py",
        "(high * timeconst * dampratio) ** 2, 2 / (high * timeconst)",
        "(high * timeconst * dampratio) ** 2, 1 / (high * timeconst)",
        f"{ACCELERATIONS}[half_cheetah]",
    ),
    (
        "tree-without-elimination",
        "physics/tree_solver.py",
        "h[i, j] = h[i, j] - ratio * h[k, j]",
        "h[i, j] = h[i, j] - 0.9 * ratio * h[k, j]",
        "envs/physics/test_tree_solver.py::test_any_tree",
    ),
    (
        "pendulum-scored-after-the-step",
        "pendulum.py",
        "wrap_angle(physics.qpos[0]), physics.qvel[0]\n        return",
        "wrap_angle(after.qpos[0]), after.qvel[0]\n        return",
        "envs/test_pendulum.py",
    ),
    (
        "crippled-hips-stay-strong",
        "ant.py",
        'for joint in ("hip", "ankle"):\n        spec',
        'for joint in ("ankle",):\n        spec',
        "envs/test_ant.py",
    ),
    (
        "contacts-pull",
        "physics/contact_solver.py",
        "jnp.tile(stiffness * (depth < 0), 4)",
        "jnp.tile(stiffness, 4)",
        f"{ACCELERATIONS}[half_cheetah]",
    ),
    (
        "maze-scored-after-the-step",
        "point_maze.py",
        "to_goal = physics.qpos",
        "to_goal = after.qpos",
        "envs/test_point_maze.py",
    ),
    (
        "low-ant-before-the-step",
        "ant.py",
        "(after.qpos[2] < 0.2)",
        "(physics.qpos[2] < 0.2)",
        "envs/test_ant.py::test_being_near_the_ground_costs_one",
    ),
)

PIPELINE = bugs_of(
    "experiments/pipeline",
    (
        "retrained-with-the-recipes-actions",  # not caught in November 2026
        "experiment.py",
        "self.with_config(actions=learned.actions, horizon=kind)",
        "self.with_config(horizon=kind)",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "source-retrain-in-the-target",  # not caught in November 2026
        "stages.py",
        "shortened(use.back_home, use.rule)",
        "shortened(use.target, use.rule)",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "repeats-chosen-by-the-true-return",
        "stages.py",
        "learned.argmax(axis=0)[None]",
        "true.argmax(axis=0)[None]",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "restart-of-another-seed",
        "stages.py",
        "worth(folder).policies.argmax(axis=0) * seeds + np.arange(seeds)",
        "np.full(seeds, worth(folder).policies.mean(axis=1).argmax()) * seeds + np.arange(seeds)",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "lost-chunk-kept-twice",
        "train.py",
        "folder.keep_metrics((done - first) * len(labels), labels)",
        "folder.keep_metrics(len(folder.metrics()), labels)",
        "experiments/pipeline/test_train.py::test_a_killed_run_goes_on_bit_identically",
    ),
    (
        "seeds-are-positions",
        "stages.py",
        'lane_keys(LEARN, [lane["seed"] for lane in labels])',
        "lane_keys(LEARN, list(range(len(labels))))",
        "experiments/commands/test_imitate.py::test_another_first_seed",
    ),
    (
        "scores-without-random-actions",
        "experiment.py",
        "(returns - self.random) / (self.expert - self.random)",
        "returns / self.expert",
        "experiments/pipeline/test_run.py",
    ),
    (
        "metrics-count-from-0",
        "run_folder.py",
        "iteration = first_iteration + t + 1",
        "iteration = first_iteration + t",
        "experiments/pipeline/test_run_folder.py",
    ),
    (
        "one-setting-may-differ",
        "run_folder.py",
        "    if different:",
        "    if len(different) > 1:",
        "experiments/pipeline/test_run_folder.py",
    ),
    (
        "share-from-0",
        "stages.py",
        "(reached - random) / np.where",
        "reached / np.where",
        "experiments/pipeline/test_diagnosis.py",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "any-better-return-is-a-mistake",
        "diagnosis.py",
        "margin = BETTER * (",
        "margin = 0.0 * (",
        "experiments/pipeline/test_diagnosis.py",
    ),
    (
        "true-reward-with-temperature",
        "stages.py",
        "dataclasses.replace(hparams, temperature=0.0)",
        "hparams",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "wide-std-for-the-others",
        "stages.py",
        "np.where(is_random, recipe.random_std, 1.0)",
        "np.where(is_random, 1.0, recipe.random_std)",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "plans-of-another-reward",
        "stages.py",
        "np.swapaxes(leaf, 0, 1).reshape(-1",
        "leaf.reshape(-1",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "phases-share-their-keys",
        "train.py",
        "jax.random.PRNGKey(phase)",
        "jax.random.PRNGKey(0 * phase)",
        "experiments/pipeline/test_train.py::test_every_phase_and_every_seed_draws_other_random_numbers",
    ),
    (
        "score-depends-on-the-lane",
        "train.py",
        "lane_keys(EVALUATE, seeds)",
        "lane_keys(EVALUATE, range(len(seeds)))",
        "experiments/commands/test_imitate.py::test_another_first_seed",
        "experiments/commands/test_sweep.py",
    ),
    (
        "judged-without-the-absorbing-state",
        "stages.py",
        "seen = horizon.extended(steps, training.config)\n        return",
        "seen = steps\n        return",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "expert-judged-beyond-the-bounds",
        "stages.py",
        "demos = clip_actions(target.demos, target.env, training.config)",
        "demos = target.demos",
        "experiments/pipeline/test_stages.py",
    ),
    (
        "worst-expert",
        "policies.py",
        "np.argmax(last_tenth(curves)[kept])",
        "np.argmin(last_tenth(curves)[kept])",
        "experiments/pipeline/test_policies.py",
    ),
    (
        "horizon-forgotten-in-the-target",
        "experiment.py",
        'kind = "fixed"  # the',
        "kind = kind  # the",
        "experiments/pipeline/test_stages.py::test_policies_are_trained_with_the_horizon_that_the_reward_knows",
    ),
    (
        "tracked-twice-after-a-kill",
        "trackers.py",
        "first, now = training.done * training.steps + 1, time.time()",
        "first, now = (training.done + 3) * training.steps + 1, time.time()",
        "experiments/pipeline/test_trackers.py",
    ),
    (
        "folder-of-another-run",
        "default_folder.py",
        "if not changed or _is_run(plain, settings):",
        "if not changed or plain.exists():",
        "experiments/pipeline/test_default_folder.py",
    ),
)

BUGS = (*LIBRARY, *PHYSICS, *PIPELINE)
