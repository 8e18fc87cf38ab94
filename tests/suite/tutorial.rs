//! The commands of docs/tutorial.md run as printed, in its order, on its own files. Only the run is shortened: two frames on a third of the cells.

use std::fs;
use std::path::Path;
use std::process::Command;

/// Blocks of a page: kind and content.
fn blocks(page: &str) -> Vec<(&str, &str)> {
    let mut parts = page.split("```");
    let mut blocks = Vec::new();
    while let (Some(_), Some(block)) = (parts.next(), parts.next()) {
        blocks.push(block.split_once('\n').expect("a block of lines"));
    }
    blocks
}

#[test]
fn the_commands_of_the_tutorial_run() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let page = fs::read_to_string(root.join("docs/tutorial.md")).unwrap();
    let meshes = folder.path().join("scenes/meshes");
    fs::create_dir_all(&meshes).unwrap();
    fs::copy(
        root.join("scenes/meshes/dinosaur.vtu"),
        meshes.join("dinosaur.vtu"),
    )
    .unwrap();
    let mut commands = Vec::new();
    for (kind, block) in blocks(&page) {
        if kind == "toml" {
            fs::write(folder.path().join("splash.toml"), block).unwrap();
        } else if block.starts_with("v ") {
            fs::write(folder.path().join("crate.obj"), block).unwrap();
        }
        let lines = block
            .lines()
            .map(|line| line.split('#').next().unwrap().trim());
        commands.extend(lines.filter(|line| line.starts_with("cutwater ")));
    }
    let mut run = Vec::new();
    for command in commands {
        let mut arguments: Vec<&str> = command.split_whitespace().skip(1).collect();
        run.push(arguments[0]);
        if arguments[0] == "run" {
            arguments.extend(["--frames", "2", "--scale", "0.34", "--backend", "cpu"]);
        }
        let output = Command::new(env!("CARGO_BIN_EXE_cutwater"))
            .current_dir(folder.path())
            .args(&arguments)
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{command}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    // The page still shows each of them.
    for name in ["mesh", "plan", "run", "preview", "skin"] {
        assert!(run.contains(&name), "no `cutwater {name}` among {run:?}");
    }
    for file in [
        "frames/splash_crate_000002.ply",
        "frames/splash_crate.glb",
        "frames/splash_dinosaur.glb",
        "preview/splash.png",
    ] {
        assert!(
            folder.path().join("out/splash").join(file).is_file(),
            "{file}"
        );
    }
}
