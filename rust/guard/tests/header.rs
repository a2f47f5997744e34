//! The C header: it compiles as C99 without a warning, has the numbers of the crate, and its functions decide the same.

use std::path::{Path, PathBuf};
use std::process::Command;

use needleplan_guard::cause::Cause;

const CRATE: &str = env!("CARGO_MANIFEST_DIR");

fn header() -> String {
    std::fs::read_to_string(Path::new(CRATE).join("include/needleplan_guard.h")).unwrap()
}

#[test]
fn it_numbers_the_causes_as_the_crate_does() {
    let text = header();
    for (number, cause) in Cause::ALL.iter().enumerate() {
        assert!(text.contains(&format!("    GUARD_{} = {number}", cause.name().to_uppercase())), "{cause:?}");
    }
    assert!(!text.contains(&format!(" = {}", Cause::ALL.len())));
}

/// The crate as a library for C, with all that `std` would bring left out.
fn library(folder: &Path) -> PathBuf {
    let (rlib, archive) = (folder.join("libneedleplan_guard.rlib"), folder.join("libguard.a"));
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let built = |arguments: &[&str], source: &Path, output: &Path| {
        let mut command = Command::new(&rustc);
        command.args(["--edition=2024", "-Copt-level=1", "-Cpanic=abort"]).args(arguments);
        let status = command.arg(source).arg("-o").arg(output).status().unwrap();
        assert!(status.success());
    };
    let source = Path::new(CRATE).join("src/lib.rs");
    built(&["--crate-type=rlib", "--crate-name=needleplan_guard", "--cfg=feature=\"c\""], &source, &rlib);
    let external = format!("--extern=needleplan_guard={}", rlib.display());
    let source = Path::new(CRATE).join("tests/c/library.rs");
    built(&["--crate-type=staticlib", "--crate-name=guard", &external], &source, &archive);
    archive
}

#[test]
fn a_c_program_decides_as_the_crate_does() {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    if Command::new(&compiler).arg("--version").output().is_err() {
        eprintln!("skipped: there is no C compiler");
        return;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("header");
    std::fs::create_dir_all(&folder).unwrap();
    let (archive, program) = (library(&folder), folder.join("program"));
    let mut command = Command::new(&compiler);
    command.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"]);
    command.arg(Path::new(CRATE).join("include")).arg(Path::new(CRATE).join("tests/c/program.c"));
    command.arg(archive).arg("-lm").arg("-o").arg(&program);
    assert!(command.status().unwrap().success());
    let output = Command::new(&program).arg(Path::new(CRATE).join("tests/transitions.csv")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}
