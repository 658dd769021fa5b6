//! The tests of the Python package, which are Python: pytest over the library that cargo built with
//! the daily profile. `make test-python` runs the long ones, too.

use std::{
    env, fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

/// The native library, beside this program.
fn library() -> PathBuf {
    let program = env::current_exe().unwrap();
    let folder = program.parent().unwrap();
    let named = |folder: &Path| {
        folder.join(format!(
            "{}_reel{}",
            env::consts::DLL_PREFIX,
            env::consts::DLL_SUFFIX
        ))
    };
    let found = [folder, folder.parent().unwrap()]
        .map(named)
        .into_iter()
        .find(|path| path.is_file());
    found.expect("cargo builds the library for this test")
}

/// The folder of the package's Python.
fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python")
}

/// A folder to import the package from, without installing it: links to its files and the library.
fn package() -> PathBuf {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python-package");
    let _absent = fs::remove_dir_all(&root);
    for package in ["reel", "reel_household"] {
        link_all(&sources().join(package), &root.join(package));
    }
    symlink(library(), root.join("reel/_reel.abi3.so")).unwrap();
    root
}

/// Links to all files of a folder but those that Python or a build made.
fn link_all(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        if path.is_dir() && name != "__pycache__" {
            link_all(&path, &to.join(name));
        } else if path.is_file() && path.extension().is_none_or(|kind| kind != "so") {
            symlink(&path, to.join(name)).unwrap();
        }
    }
}

#[test]
fn the_package_passes_its_tests() {
    let Some(python) = reel_vectors::python("pytest, tqdm, polars, gymnasium, nbclient, anywidget")
    else {
        return;
    };
    let package = package();
    println!(
        "PYTHONPATH={} {} -m pytest python/tests",
        package.display(),
        python.display()
    );
    let mut pytest = Command::new(python);
    pytest
        // not the folder of the package, which would be imported from there
        .current_dir(sources().join("tests"))
        .env("PYTHONPATH", &package)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .args([
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "--ignore=long",
            ".",
        ]);
    reel_vectors::run(&mut pytest);
}
