//! Tells the program which sources it is built from: tables that were measured say so.

use std::fs;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// All that decides what the program computes, of which the embedded scenes are a part.
const SOURCES: [&str; 6] = ["Cargo.lock", "Cargo.toml", "build.rs", "scenes", "shaders", "src"];

fn main() {
    let mut files = Vec::new();
    for source in SOURCES {
        println!("cargo:rerun-if-changed={source}");
        gather(Path::new(source), &mut files);
    }
    files.sort();
    let mut digest = Sha256::new();
    for file in files {
        let content = fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let name = file.to_string_lossy().replace('\\', "/");
        digest.update(name.as_bytes());
        digest.update((content.len() as u64).to_le_bytes());
        digest.update(content);
    }
    let digest = digest.finalize();
    let first: String = digest[..6].iter().map(|byte| format!("{byte:02x}")).collect();
    println!("cargo:rustc-env=CUTWATER_SOURCES={first}");
}

/// A file, or all files below a folder but for hidden ones, which editors leave there.
fn gather(path: &Path, files: &mut Vec<PathBuf>) {
    if !path.is_dir() {
        files.push(path.to_owned());
        return;
    }
    let entries = fs::read_dir(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    for entry in entries {
        let entry = entry.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        if !entry.file_name().as_encoded_bytes().starts_with(b".") {
            gather(&entry.path(), files);
        }
    }
}
