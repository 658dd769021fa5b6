"""Whether the flags in the recipes of docs/training.md exist: read from the source of the trainers' wheels, without running them.

    python3 tests/training/check_recipes.py [--wheels DIR] [--reel BINARY]

Downloads the wheels of the pinned versions without what they depend on (15 MB). Flags of `reel` are looked up in its help.
"""

import argparse
import ast
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import zipfile

DOCS = pathlib.Path(__file__).parents[2] / "docs" / "training.md"
PINNED = ["ms_swift==4.6.0", "llamafactory==0.9.5", "trl==1.16.0", "transformers==5.6.0"]
# Whose classes define the flags of a program, and the variables it reads from the environment.
PROGRAMS = {"swift": ["ms_swift", "transformers"], "llamafactory-cli": ["llamafactory", "transformers"]}
CONFIGS = {"SFTConfig": ["trl", "transformers"]}
IS_OPTIONS = re.compile(r"(Arguments|Config|ArgumentsMixin|ArgsMixin|Args)$")


def sources(wheel):
    """The files of a wheel that may define options, and all its text."""
    with zipfile.ZipFile(wheel) as files:
        return [files.read(name).decode() for name in files.namelist() if name.endswith(".py")]


def options(texts):
    """Fields of all classes that hold options."""
    found = set()
    for text in texts:
        if not re.search(r"class \w*(Arguments|Config|Mixin|Args)\b", text):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ClassDef) and IS_OPTIONS.search(node.name):
                found |= {item.target.id for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)}
    return found


def commands(text):
    """The commands of the shell blocks, as ({variables}, words)."""
    for block in re.findall(r"^```sh\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            names = [word.split("=")[0] for word in words if re.fullmatch(r"[A-Z_]+=.*", word)]
            words = [word for word in words if not re.fullmatch(r"[A-Z_]+=.*", word)]
            if words:
                yield names, words


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--wheels", type=pathlib.Path)
    arguments.add_argument("--reel")
    arguments = arguments.parse_args()
    folder = arguments.wheels or pathlib.Path(tempfile.mkdtemp())
    subprocess.run([sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", folder, *PINNED], check=True)
    texts = {pin.split("==")[0]: sources(next(folder.glob(f"{pin.replace('==', '-')}*.whl"))) for pin in PINNED}
    known = {package: options(some) for package, some in texts.items()}
    docs, checked, wrong = DOCS.read_text(), 0, []

    for variables, words in commands(docs):
        flags = [word[2:].split("=")[0] for word in words if word.startswith("--")]
        if words[0] in PROGRAMS:
            packages = PROGRAMS[words[0]]
            missing = [flag for flag in flags if not any(flag in known[package] for package in packages)]
            missing += [name for name in variables if not any(name in text for text in texts[packages[0]])]
            checked += len(flags) + len(variables)
        elif words[0] == "reel" and arguments.reel:
            verbs = [word for word in words[1:3] if re.fullmatch(r"[a-z]+", word)]
            help_text = subprocess.run([arguments.reel, *verbs, "--help"], capture_output=True, text=True, check=False).stdout
            missing = [flag for flag in flags if f"--{flag}" not in help_text]
            checked += len(flags)
        else:
            continue
        wrong += [f"{words[0]}: {flag}" for flag in missing]
    for block in re.findall(r"^```python\n(.*?)^```", docs, flags=re.DOTALL | re.MULTILINE):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CONFIGS:
                given = [keyword.arg for keyword in node.keywords]
                wrong += [f"{node.func.id}: {name}" for name in given if not any(name in known[package] for package in CONFIGS[node.func.id])]
                checked += len(given)
    print(f"{checked} flags, fields and variables checked; unknown: {', '.join(wrong) or 'none'}")
    sys.exit(1 if wrong or not checked else 0)


if __name__ == "__main__":
    main()
