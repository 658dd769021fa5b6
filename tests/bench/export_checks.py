"""What `reel export sft` looks for in every text before it becomes a row, for `export_python.py`: signs of privileged text, the
words of the task that an agent must not know, JSON that tells a world graph or a plan, all that in disguise, and tags that
trainers take for turns or images.

The signs are read from where they stand (`src/dataset/src/privileged.rs`). RE2 looks for them all at once, two hundred times
faster than `re`; the texts of an episode are looked at together, and one by one only where that finds something.
"""

import base64
import functools
import json
import re
from pathlib import Path

import re2

SOURCE = Path(__file__).parents[2] / "src/dataset/src/privileged.rs"
# Places of one text where JSON is tried to be read.
JSON_TRIES_MAX = 256
TAGS = (
    "<image>", "<video>", "<audio>", "<|", "<think>", "</think>",
    "<tool_call>", "</tool_call>", "<tool_response>", "</tool_response>",
)  # fmt: skip


def signs():
    source = SOURCE.read_text()
    part = source[source.index("const SIGNS") : source.index("static DEBUG_INFO")]
    found = re.findall(r'LeakKind::\w+,\s*r(#?)"(.+?)"\1,?\s*\)', part, re.DOTALL)
    assert len(found) == part.count("LeakKind::")
    return "|".join(f"(?:{sign})" for _, sign in found)


PRIVILEGED = re2.compile(f"(?i){signs()}")
BASE64_RUN = re2.compile("(?i)[a-z0-9+/_-]{24,}={0,2}")
ESCAPES = re.compile(r"\\u([0-9a-f]{4})|\\x([0-9a-f]{2})|%([0-9a-f]{2})|&#([0-9]{1,6});|&#x([0-9a-f]{1,5});", re.IGNORECASE)
INVISIBLE = re.compile("[\u00ad\u200b-\u200f\u2060-\u2064\ufeff]")
DEBUG_INFO = re.compile(r"\bdebug[ _-]?info", re.IGNORECASE)
OPENER = re.compile(r"[{\[]")
raw_decode = json.JSONDecoder().raw_decode


class Secrets:
    """What is privileged in one task: words, found whole whatever their case, but for those that the agent knows."""

    def __init__(self, words, public):
        self.public = {word.lower() for word in public}
        self.words = sorted({word.strip().lower() for word in words} - self.public - {""})

    @classmethod
    def of_task(cls, fields):
        assets = [thing["asset"] for thing in fields["objects"]] + fields.get("object_distractors", [])
        words = [thing["instance"] for thing in fields["objects"]] + [asset for asset in assets if re.search(r"\d", asset)]
        if fields["instruction"] != fields["precise_instruction"]:
            words.append(fields["precise_instruction"])
        return cls([*words, fields["task_id"]], fields["initial"])

    def within(self, text):
        text = text.lower()
        return any(word in text and whole(word, text) for word in self.words)


NO_SECRETS = Secrets((), ())


def whole(word, text):
    return re.search(rf"(?<![0-9a-z_]){re.escape(word)}(?![0-9a-z_])", text, re.ASCII)


def refused(text, secrets):
    """Whether a text may not go out."""
    return bool(text) and ("<" in text and any(tag in text for tag in TAGS) or privileged(text, secrets))


def clean(texts, secrets):
    """Whether none of many texts has to be refused: one look at all of them may say so."""
    together = "\n\0\n".join(filter(None, texts))
    return together.count("{") + together.count("[") <= JSON_TRIES_MAX and not refused(together, secrets)


def privileged(text, secrets):
    return leaks(text, secrets) or any(leaks(plain, secrets) for plain in disguises(text))


def leaks(text, secrets):
    if secrets.within(text):
        return True
    at = 0
    while found := PRIVILEGED.search(text, at):
        if found[0].lower() not in secrets.public:
            return True
        at = found.end()
    return any(tells(value, secrets) for value, _, _ in json_values(text))


def json_values(text):
    """The outermost JSON objects and arrays in a text, and where they stand."""
    at = tries = 0
    while (found := OPENER.search(text, at)) and tries < JSON_TRIES_MAX:
        start, tries = found.start(), tries + 1
        try:
            value, at = raw_decode(text, start)
        except (ValueError, RecursionError):
            at = start + 1
        else:
            yield value, start, at


def tells(value, secrets):
    """What a JSON value tells by its shape, or a text within it."""
    if isinstance(value, dict):
        places = [key for key, held in value.items() if isinstance(held, (list, dict)) and is_place(key, secrets)]
        states = [held for held in value.values() if isinstance(held, dict) and "role" not in held]
        if len(places) >= 2 or any(isinstance(held.get("content"), list) for held in states):
            return True
        return any(tells(held, secrets) for held in value.values())
    if isinstance(value, list):
        calls = [item for item in value if isinstance(item, dict) and item.keys() & CALLED and item.keys() & GIVEN]
        return len(calls) >= 2 or any(tells(item, secrets) for item in value)
    return isinstance(value, str) and any(mark in value for mark in '"{[') and leaks(value, secrets)


CALLED, GIVEN = {"action", "tool_name", "name"}, {"args", "arguments"}


def is_place(key, secrets):
    return key in secrets.public or "_" in key and key[-1:].isdigit()


def disguises(text):
    """Other readings: without invisible characters, escapes undone, base64 decoded."""
    if not text.isascii() and INVISIBLE.search(text):
        yield INVISIBLE.sub("", text)
    if "\\" in text or "%" in text or "&" in text:
        unescaped = ESCAPES.sub(unescape, text)
        if unescaped != text:
            yield unescaped
    for run in BASE64_RUN.finditer(text):
        digits = run[0].rstrip("=")
        for alphabet in (b"+/", b"-_"):
            try:
                yield base64.b64decode(digits + "=" * (-len(digits) % 4), alphabet, validate=True).decode()
                break
            except ValueError:
                pass


def unescape(escape):
    digits, base = escape[escape.lastindex], 10 if escape.lastindex == 4 else 16
    number = int(digits, base)
    return chr(number) if number < 0xD800 or 0xE000 <= number < 0x110000 else ""


@functools.lru_cache(4096)
def strip(text):
    """A tool's outcome without whole payloads: a block of `Debug Info`, JSON that is privileged."""
    cuts, begin = [], 0
    header = DEBUG_INFO.search(text)
    if header:
        begin = len(text)
        body = text.find("{", header.end())
        if body >= 0:
            try:
                begin = raw_decode(text, body)[1]
            except (ValueError, RecursionError):
                pass
        cuts.append((header.start(), begin))
    if "{" in text or "[" in text:
        for value, start, end in json_values(text):
            if start >= begin and (tells(value, NO_SECRETS) or PRIVILEGED.search(text[start:end])):
                cuts.append((start, end))
    if not cuts:
        return text
    kept, begin = [], 0
    for start, end in sorted(cuts):
        kept.append(text[min(begin, start) : start])
        begin = max(begin, end)
    return "".join([*kept, text[begin:]]).strip()
