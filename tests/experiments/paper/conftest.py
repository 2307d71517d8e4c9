"""Results that a test can make in one line."""

import numpy as np
import pytest

from eairl_jax.experiments.pipeline.diagnosis import FROM_EXPERT, RANDOM, TRAINED, Behaviour, Diagnosis
from eairl_jax.experiments.pipeline.places import Reference
from eairl_jax.experiments.pipeline.run import Result

MEASURES = ("epic", *(f"rank correlation, {transitions}" for transitions in ("expert", "policy", "random")))
WORTH = tuple(f"worth, {who}" for who in ("random", "expert", "policy", "retrained"))


def diagnosed(returns, share=1.0):
    """The diagnosis of policies of these returns that reach a share of the best known learned reward."""
    seeds = np.ones(len(returns))
    behaviours = {
        TRAINED: Behaviour(share * seeds, np.array(returns, float)),
        FROM_EXPERT: Behaviour(seeds, 10.0 * seeds),
        RANDOM: Behaviour(0.0 * seeds, 0.0 * seeds),
    }
    return Diagnosis(behaviours, Reference(expert=10.0, random=0.0)).to_json()


@pytest.fixture(scope="session")
def make_diagnosis():
    """See `diagnosed`."""
    return diagnosed


@pytest.fixture(scope="session")
def make_result():
    """A function that makes a result in a task whose expert has a return of 10 and whose random actions have 0."""

    def make(name, returns, task="pendulum", target=None, rule=None, **fields):
        measures = {measure: [0.5, None] for measure in MEASURES} | {who: [1.0, 2.0] for who in WORTH}
        config = {"iterations": 4, "num_envs": 2, "rollout_length": 5}
        defaults = {
            "method": name.split("-")[0],
            "seeds": list(range(len(returns))),
            "expert": 10.0,
            "random": 0.0,
            "env_steps": 40,
            "compile_seconds": 12.0,
            "run_seconds": 60.0,
            "peak_memory_gb": 1.0,
            "command_line": "eairl reproduce all",
            "is_published": "+" not in name,
            "settings": {"config": config, "hparams": {"entropy_weight": 0.1, "lambda_i": 1.0}},
            "ceiling": [9.0, 10.0] if target else [],
            "imitation_returns": [7.0, 7.0] if target else [],
            "closeness": {"source": measures, "target": measures} if target and target != task else None,
            "diagnosis": diagnosed(returns) if target and target != task and rule == "last" else None,
            "curve": {"env_steps": [10, 20], "true_return": [[None, 1.0], [0.0, 2.0]]},
            "machine": {"date": "2026-11-22", "devices": 2, "device": "cpu", "versions": {"jax": "0.10"}},
        }
        return Result(name=name, returns=returns, task=task, target=target, rule=rule, **defaults | fields)

    return make


@pytest.fixture(scope="session")
def results_of():
    """A function that makes the results of every experiment from those of each."""

    def make(table2=(), table1=(), ablations=()):
        return {
            "table1": [*table1],
            "table2": [*table2],
            "ablations": [*ablations],
            "sources": [],
            "imperfect": [],
            "styles": [],
        }

    return make
