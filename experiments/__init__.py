"""Commands that join the algorithms of `eairl_jax` and the tasks of `envs`: experts, demonstrations, experiments."""
