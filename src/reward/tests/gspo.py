"""The formulas of GSPO in plain NumPy: what reel-reward is compared with.

Reads cases as JSON from stdin and writes results as JSON to stdout. Formulas: Zheng et al., Group Sequence Policy
Optimization (arXiv 2507.18071); advantages as NGRPO and ms-swift's GRPOTrainer compute them; J. Schulman, Approximating
KL divergence (2020); clip shares as TRL's GRPOTrainer logs them.
"""

import json
import sys

import numpy as np


def group(case):
    new, old, ref = ([np.array(tokens) for tokens in case[name]] for name in ("new", "old", "ref"))
    low, high = case["low"], case["high"]
    discounts = case["gamma"] ** np.arange(case["steps"])
    returns = np.array(case["rewards"]) @ discounts
    advantages = (returns - returns.mean()) / (returns.std() + case["eps"])
    ratios = np.array([np.exp((a - b).mean()) for a, b in zip(new, old)])
    best = returns.max()
    joined = np.append(returns, best + max(0.1 * abs(best), 0.5))
    centred = returns - returns.mean()
    others = np.array([np.delete(returns, i).mean() for i in range(len(returns))])
    std = returns.std(ddof=1) + 1e-4
    estimates = {
        "paper": advantages,
        "ngrpo": (returns - joined.mean()) / np.sqrt(joined.var() + 1e-8),
        "grpo": centred / std,
        "rloo": (returns - others) / std,
        "reinforce++": centred / (centred.std(ddof=1) + 1e-4),
    }
    estimators = {
        "k1": lambda d: -d,
        "k2": lambda d: d**2 / 2,
        "k3": lambda d: np.exp(d) - d - 1,
    }
    kl = {name: [float(f(r - a).mean()) for r, a in zip(ref, new)] for name, f in estimators.items()}
    clipped = np.clip(ratios, 1 - low, 1 + high)
    surrogate = np.minimum(ratios * advantages, clipped * advantages)
    tokens = [np.exp(a - b) for a, b in zip(new, old)]
    token_advantages = np.concatenate([np.full(len(t), a) for t, a in zip(tokens, advantages)])
    tokens = np.concatenate(tokens)
    return {
        "returns": returns.tolist(),
        "advantages": {name: estimate.tolist() for name, estimate in estimates.items()},
        "ratios": ratios.tolist(),
        "kl": kl,
        "surrogate": float(surrogate.mean()),
        "loss": float(-surrogate.mean() + case["beta"] * np.mean(kl["k3"])),
        "clipped": [float(((ratios < 1 - low) & (advantages < 0)).mean()), float(((ratios > 1 + high) & (advantages > 0)).mean())],
        "clipped_tokens": [
            float(((tokens < 1 - low) & (token_advantages < 0)).mean()),
            float(((tokens > 1 + high) & (token_advantages > 0)).mean()),
        ],
    }


json.dump([group(case) for case in json.load(sys.stdin)], sys.stdout)
