"""From demonstrations to a reward, from a reward to a policy, from a policy to a score."""
