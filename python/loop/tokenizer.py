"""Text into words, numbers, punctuation and phrases, and back without loss.

A word outside the vocabulary is spelled in characters, so a name of a home never seen can be read and copied. Text that nearly all prompts
share (the list of tools, the sentences around the values) becomes phrases: one token each. A single space between two words is implied.
"""

import collections
import json
import pathlib
import re
from collections.abc import Iterable, Sequence

PIECE = re.compile(r"<image>|[A-Za-z]+|[_/]?[0-9]+|\s*(?:(?![_/][0-9]|<image>)[^A-Za-z0-9\s]\s*)+|\s+")
NUMBER = re.compile(r"[_/][0-9]+")
PAD, ANSWER, END, IMAGE, JOIN = range(5)
SPECIAL = ["<pad>", "<answer>", "<end>", "<image>", "<join>"]
CONTINUED = "##"
LONGEST_PHRASE = 24


def split(text: str) -> list[str]:
    """The pieces of a text. `<join>` stands between two words without a space between them."""
    pieces: list[str] = []
    for piece in PIECE.findall(text):
        if pieces and pieces[-1][-1:].isalnum() and piece[:1].isalnum() and pieces[-1] != SPECIAL[IMAGE]:
            pieces.append(SPECIAL[JOIN])
        pieces.append(piece)
    spaced: list[str] = []
    for index, piece in enumerate(pieces):
        between_words = 0 < index < len(pieces) - 1 and pieces[index - 1][-1:].isalnum() and pieces[index + 1][:1].isalnum()
        if not (piece == " " and between_words):
            spaced.append(piece)
    return spaced


def join(pieces: Iterable[str]) -> str:
    """The inverse of `split`."""
    text, joined = "", False
    for piece in pieces:
        if piece == SPECIAL[JOIN]:
            joined = True
            continue
        gap = not joined and text[-1:].isalnum() and piece[:1].isalnum()
        text += (" " if gap else "") + piece
        joined = False
    return text


def shared_runs(texts: Sequence[str], share: float) -> list[str]:
    """The longest runs of whole lines that stand in at least `share` of the texts. Lines that name receptacles or rooms belong to none."""
    lines = [text.splitlines(keepends=True) for text in texts]
    frequency = collections.Counter(line for one in lines for line in set(one))
    common = {line for line, count in frequency.items() if count >= share * len(texts) and not NUMBER.search(line) and SPECIAL[IMAGE] not in line}
    runs: collections.Counter[str] = collections.Counter()
    for one in lines:
        found, run = set[str](), ""
        for line in [*one, ""]:
            if line in common and line.endswith("\n"):
                run += line
            elif run:
                found.add(run)
                run = ""
        runs.update(found)
    return sorted(run for run, count in runs.items() if count >= share * len(texts))


def phrases(documents: Sequence[list[str]], share: float, most: int) -> list[list[str]]:
    """Neighbouring pieces that are one piece in at least `share` of the documents, found by merging pairs.

    Digits stay by themselves, and so do the words before them: names are copied piece by piece.
    """
    names = {one for document in documents for one, other in zip(document, document[1:]) if NUMBER.fullmatch(other)}
    parts: list[list[str]] = []  # the pieces of each merged part
    known: dict[str, int] = {}
    free: list[bool] = []
    sequences: list[list[int]] = []
    for document in documents:
        for piece in document:
            if piece not in known:
                known[piece] = len(parts)
                parts.append([piece])
                free.append(not (piece in names or piece in SPECIAL or any(map(str.isdigit, piece))))
        sequences.append([known[piece] for piece in document])
    # The documents of each pair of neighbours.
    pairs: dict[tuple[int, int], set[int]] = collections.defaultdict(set)
    for index, sequence in enumerate(sequences):
        for pair in zip(sequence, sequence[1:]):
            pairs[pair].add(index)
    usable = lambda pair: free[pair[0]] and free[pair[1]] and len(parts[pair[0]]) + len(parts[pair[1]]) <= LONGEST_PHRASE
    found: list[list[str]] = []
    while len(found) < most:
        pair = max((pair for pair in pairs if usable(pair)), key=lambda pair: (len(pairs[pair]), parts[pair[0]], parts[pair[1]]), default=None)
        if pair is None or len(pairs[pair]) < share * len(documents):
            break
        whole = len(parts)
        parts.append(parts[pair[0]] + parts[pair[1]])
        free.append(True)
        found.append(parts[whole])
        for index in sorted(pairs[pair]):
            before, kept = sequences[index], list[int]()
            for part in before:
                if kept and kept[-1] == pair[0] and part == pair[1]:
                    kept[-1] = whole
                else:
                    kept.append(part)
            sequences[index] = kept
            old, new = set(zip(before, before[1:])), set(zip(kept, kept[1:]))
            for gone in old - new:
                pairs[gone].discard(index)
            for come in new - old:
                pairs[come].add(index)
        pairs.pop(pair, None)
        if len(pairs) > 50_000 or len(found) % 20 == 0:
            pairs = collections.defaultdict(set, {one: some for one, some in pairs.items() if len(some) >= share * len(documents) / 2})
    return found


class Tokenizer:
    """Pieces and their ids; `ids` and `text` are each other's inverse for characters that the training set has."""

    def __init__(self, pieces: list[str], runs: list[str], merges: list[list[str]]) -> None:
        self.pieces, self.runs, self.merges = pieces, sorted(runs, key=len, reverse=True), merges
        self.numbers = {piece: number for number, piece in enumerate(pieces)}
        self.by_first: dict[str, list[list[str]]] = collections.defaultdict(list)
        for phrase in sorted(merges, key=len, reverse=True):
            self.by_first[phrase[0]].append(phrase)

    @classmethod
    def of(cls, prompts: Sequence[str], answers: Sequence[str], least: int = 3, share: float = 0.15, most: int = 200) -> "Tokenizer":
        """The tokenizer of a training set: words that stand in `least` documents, and phrases."""
        runs = shared_runs(prompts, 0.95)
        rests = [rest for prompt in prompts for rest in cut(prompt, runs) if rest not in runs]
        documents = [split(text) for text in [*rests, *answers]]
        sample = documents[:: max(1, len(documents) // 400)]
        merges = phrases(sample, share / 2, most)
        found = collections.Counter(piece for document in documents for piece in set(document))
        characters = sorted({character for piece in found for character in piece} | set(map(chr, range(32, 127))) | {"\n"})
        words = sorted(piece for piece, count in found.items() if count >= least and len(piece) > 1 and piece not in SPECIAL)
        pieces = SPECIAL + characters + [CONTINUED + character for character in characters] + words
        pieces += [text for text in (join(phrase) for phrase in merges) if text not in set(pieces)] + runs
        return cls(list(dict.fromkeys(pieces)), runs, merges)

    def __len__(self) -> int:
        return len(self.pieces)

    def ids(self, text: str) -> list[int]:
        """The tokens of a text."""
        numbers: list[int] = []
        for part in cut(text, self.runs):
            if part in self.numbers and part in self.runs:
                numbers.append(self.numbers[part])
            else:
                numbers.extend(self.word_ids(split(part)))
        return numbers

    def word_ids(self, pieces: list[str]) -> list[int]:
        numbers: list[int] = []
        at = 0
        while at < len(pieces):
            phrase = next((one for one in self.by_first.get(pieces[at], []) if pieces[at : at + len(one)] == one), [pieces[at]])
            text = join(phrase) if len(phrase) > 1 else phrase[0]
            if text in self.numbers:
                numbers.append(self.numbers[text])
            else:
                spelled = [text[0], *(CONTINUED + character for character in text[1:])]
                numbers.extend(self.numbers[part] for part in spelled if part in self.numbers)
            at += len(phrase)
        return numbers

    def deltas(self, numbers: Iterable[int]) -> list[str]:
        """What each token adds to the text; together they are the text."""
        texts: list[str] = []
        last, joined = "", False
        for number in numbers:
            piece = self.pieces[number]
            if number == JOIN:
                joined = True
                texts.append("")
                continue
            if number < len(SPECIAL) and number != IMAGE:
                texts.append("")
                continue
            if piece.startswith(CONTINUED) and len(piece) == len(CONTINUED) + 1:
                text = piece[len(CONTINUED) :]
            else:
                gap = not joined and last.isalnum() and piece[:1].isalnum()
                text = (" " if gap else "") + piece
            texts.append(text)
            last, joined = text[-1:], False
        return texts

    def text(self, numbers: Iterable[int]) -> str:
        return "".join(self.deltas(numbers))

    def save(self, path: pathlib.Path) -> None:
        path.write_text(json.dumps({"pieces": self.pieces, "runs": self.runs, "merges": self.merges}), encoding="utf-8")

    @classmethod
    def load(cls, path: pathlib.Path) -> "Tokenizer":
        known = json.loads(path.read_text(encoding="utf-8"))
        return cls(known["pieces"], known["runs"], known["merges"])


def cut(text: str, runs: Sequence[str]) -> list[str]:
    """The text in parts, the runs of lines by themselves."""
    for run in runs:
        if run and run in text:
            before, after = text.split(run, 1)
            return [*(cut(before, runs) if before else []), run, *(cut(after, runs) if after else [])]
    return [text]
