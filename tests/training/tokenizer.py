"""Text into words, numbers and punctuation, and back without loss.

A word that is not in the vocabulary is spelled in letters, so that names never seen before (the furniture of another
home) can be read and copied.
"""

import collections
import re

PIECE = re.compile(r"</?[a-z_]+>|[A-Za-z]+(?:_[A-Za-z]+)*|[_/]?[0-9]+|\s*(?:(?![_/][0-9]|</?[a-z_]+>)[^A-Za-z0-9\s]+?\s*)+|\s+")
PAD, BEGIN, ANSWER, END = range(4)
SPECIAL = ["<pad>", "<begin>", "<answer>", "<end>"]


def split(text):
    """The pieces of a text; a single space between two words is implied."""
    return [piece for piece in PIECE.findall(text) if piece != " "]


class Tokenizer:
    """The words of the training split; `ids` and `text` are each other's inverse."""

    def __init__(self, documents, least=2):
        """Keeps what occurs in `least` documents: what one document alone has is spelled, which teaches spelling."""
        found = collections.Counter(piece for document in documents for piece in set(split(document)))
        characters = sorted({character for piece in found for character in piece} | set(map(chr, range(32, 127))))
        words = sorted(piece for piece, count in found.items() if count >= least and len(piece) > 1)
        # `##a` continues a word, `a` begins one.
        self.pieces = SPECIAL + characters + ["##" + character for character in characters] + words
        self.numbers = {piece: number for number, piece in enumerate(self.pieces)}

    def __len__(self):
        return len(self.pieces)

    def ids(self, text):
        numbers = []
        for piece in split(text):
            if piece in self.numbers:
                numbers.append(self.numbers[piece])
            else:
                spelled = [piece[0]] + ["##" + character for character in piece[1:]]
                numbers.extend(self.numbers[part] for part in spelled if part in self.numbers)
        return numbers

    def text(self, numbers):
        text = ""
        for number in numbers:
            piece = self.pieces[number]
            if number < len(SPECIAL):
                continue
            if piece.startswith("##") and len(piece) == 3:
                text += piece[2:]
            else:
                gap = text[-1:].isalnum() and piece[0].isalnum()
                text += (" " if gap else "") + piece
        return text
