"""Learn rewards from demonstrations in JAX: EAIRL and the methods that it is compared with.

The functional API, in the order in which a run uses it:

    algorithm = make_irl(env, Config(method="eairl"))       # pure functions: init, step, act
    lanes = Lanes(algorithm, keys, HParams(), demos)         # one lane for each seed
    state, metrics = lanes.run(lanes.init(), 100)            # 100 iterations in one compiled scan
    reward = learned_reward(state)                           # the reward, which other tasks can reuse

`__init__.pyi` lists the public names. Each name is imported at its first use: `import eairl_jax` itself does not
import jax.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
