"""Scores the tokens of recorded rollouts with a checkpoint, for `reel trace logprobs add`.

    reel ingest rollouts --store store
    reel export rl --store store --format ms-swift --style single-turn --max-pixels 0 --out rl
    python score.py checkpoint --rows rl --policy new > new.jsonl
    reel trace logprobs add rollouts --from new.jsonl

The rollouts were recorded with `reel bench --logprobs --extra-body '{"return_tokens_as_token_ids": true}'`, so that the tokens are those that
were drawn. Products of matrices are in 32 bits, as in the server: the checkpoint that sampled gives the same numbers within 1e-5.
"""

import argparse
import concurrent.futures
import itertools
import json
import pathlib
import sys

import torch

import checkpoint
import data
import model
import rollouts
from rollouts import Decision


def score(policy: model.Policy, decisions: list[Decision], pictures: data.Pictures, tokens: int, threads: int = 1) -> list[list[float]]:
    """Log-probabilities of the drawn tokens of each decision."""
    rows = [one.row for one in decisions]

    def scored(some: list[int]) -> list[list[float]]:
        batch = data.batch([rows[index] for index in some], pictures)
        with torch.inference_mode():
            values = policy.logprobs(batch.tokens, batch.features, batch.sequences)
        return [part.tolist() for part in values.split([len(rows[index].answer) for index in some])]

    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        return list(itertools.chain.from_iterable(pool.map(scored, data.batches(rows, tokens))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--rows", required=True, type=pathlib.Path, help="folder of `reel export rl`")
    parser.add_argument("--policy", required=True, help="name of the policy in the traces, e.g. new or ref")
    parser.add_argument("--tokens", type=int, default=6144, help="most tokens in a batch")
    parser.add_argument("--threads", type=int, default=1, help="batches at a time")
    chosen = parser.parse_args()
    policy, tokenizer = checkpoint.load(chosen.checkpoint)
    decisions, difference = rollouts.read(chosen.rows, tokenizer, policy.config), 0.0
    for one, scored in zip(decisions, score(policy, decisions, data.Pictures(policy), chosen.tokens, chosen.threads)):
        difference = max(difference, *(abs(new - old) for new, old in zip(scored, one.old)))
        print(json.dumps({"episode_id": one.episode, "step": one.call, "policy": chosen.policy, "tokens": one.tokens, "logprobs": scored}))
    print(f"largest difference from the policy that sampled: {difference:.2e}", file=sys.stderr)


if __name__ == "__main__":
    main()
