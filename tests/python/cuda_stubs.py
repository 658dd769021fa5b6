"""Lets a PyTorch of PyPI for Linux import on a machine without a GPU and without NVIDIA's libraries, which are several times as large:
writes small libraries in place of those that are missing, which say that there is no device. Needs a C compiler and readelf.

    .venv/bin/python cuda_stubs.py
"""

import collections
import pathlib
import re
import subprocess
import sysconfig
import tempfile

NVIDIA = re.compile(r"lib(cu|nccl|nv)")
# Where functions go whose version is not the name of a library.
WITHOUT_VERSION = "libnccl.so.2"
OTHER_VERSIONS = {"NVSHMEM": "libnvshmem_host.so.3"}


def readelf(path, option):
    return subprocess.run(["readelf", "-W", option, str(path)], capture_output=True, text=True, check=True).stdout


def function(name):
    """In C: what registers kernels when a library loads returns nothing, all else that there is no device (100)."""
    value = '"no CUDA device"' if name.startswith("cudaGetError") else "0" if name.startswith("__cuda") else "(void *)100"
    return f"void *{name}(void) {{ return {value}; }}\n"


def write(path, functions):
    """A library with functions by version; those without one are under the empty name."""
    script = "".join(f"{version} {{ global: {'; '.join(names)}; }};\n" for version, names in functions.items() if version)
    with tempfile.NamedTemporaryFile("w", suffix=".map") as versions:
        versions.write(script)
        versions.flush()
        compiler = ["cc", "-shared", "-fPIC", "-w", "-x", "c", "-", "-o", str(path), f"-Wl,-soname,{path.name}"]
        compiler += [f"-Wl,--version-script={versions.name}"] if script else []
        source = "".join(function(name) for names in functions.values() for name in sorted(names))
        subprocess.run(compiler, input=source, text=True, check=True)


def main():
    folder = pathlib.Path(sysconfig.get_paths()["purelib"]) / "torch" / "lib"
    needed, undefined, defined = set(), set(), set()
    for library in folder.glob("*.so*"):
        needed |= set(re.findall(r"\(NEEDED\).*\[(.*)\]", readelf(library, "-d")))
        for line in readelf(library, "--dyn-syms").splitlines():
            fields = line.split()
            if len(fields) >= 8 and fields[0][:-1].isdigit():
                name, _, version = fields[7].partition("@")
                if fields[6] != "UND":
                    defined.add(name)
                elif NVIDIA.match(version) or version in OTHER_VERSIONS or (not version and re.match(r"_*(cu|nccl|nv)", name)):
                    undefined.add((name, version))
    missing = {name for name in needed if NVIDIA.match(name) and not (folder / name).exists()}
    libraries = collections.defaultdict(lambda: collections.defaultdict(list))
    for name, version in sorted(undefined):
        if name not in defined:
            libraries[OTHER_VERSIONS.get(version, version or WITHOUT_VERSION)][version].append(name)
    for name in sorted(missing):
        write(folder / name, libraries.get(name, {}))


if __name__ == "__main__":
    main()
