//! The commands of docs/tutorial.md and docs/fsi.md run as printed, in their order, on the files of the page. Only runs are shortened.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::common::gpu;

/// A page and a folder to follow it in.
struct Page {
    text: String,
    folder: TempDir,
}

impl Page {
    fn open(name: &str) -> Page {
        Page { text: fs::read_to_string(root().join("docs").join(name)).unwrap(), folder: tempfile::tempdir().unwrap() }
    }

    /// Blocks of the page: kind and content.
    fn blocks(&self) -> Vec<(&str, &str)> {
        let mut parts = self.text.split("```");
        let mut blocks = Vec::new();
        while let (Some(_), Some(block)) = (parts.next(), parts.next()) {
            blocks.push(block.split_once('\n').expect("a block of lines"));
        }
        blocks
    }

    /// Commands in the blocks of the page.
    fn commands(&self) -> Vec<&str> {
        let lines = self.blocks().into_iter().flat_map(|(_, block)| block.lines());
        let lines = lines.map(|line| line.split('#').next().unwrap().trim());
        lines.filter(|line| line.starts_with("cutwater ")).collect()
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// Runs a command with more arguments, which must have this exit code. Returns the name of the subcommand.
    fn run<'c>(&self, command: &'c str, more: &str, code: i32) -> &'c str {
        let words = command.split_whitespace().chain(more.split_whitespace());
        // Quotes of a shell, around words without spaces.
        let arguments: Vec<&str> = words.skip(1).map(|word| word.trim_matches('\'')).collect();
        let output = Command::new(env!("CARGO_BIN_EXE_cutwater"))
            .current_dir(self.folder.path())
            .args(&arguments)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(code), "{command} {more}: {}", String::from_utf8_lossy(&output.stderr));
        command.split_whitespace().nth(1).unwrap()
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn the_commands_of_the_tutorial_run() {
    let page = Page::open("tutorial.md");
    fs::create_dir_all(page.path("scenes/meshes")).unwrap();
    let mesh = "scenes/meshes/dinosaur.vtu";
    fs::copy(root().join(mesh), page.path(mesh)).unwrap();
    for (kind, block) in page.blocks() {
        if kind == "toml" {
            fs::write(page.path("splash.toml"), block).unwrap();
        } else if block.starts_with("v ") {
            fs::write(page.path("crate.obj"), block).unwrap();
        }
    }
    let run = page.commands().into_iter().map(|command| {
        let short = match command.starts_with("cutwater run ") {
            true => "--frames 2 --scale 0.34 --backend cpu",
            false => "",
        };
        page.run(command, short, 0)
    });
    let run: Vec<&str> = run.collect();
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
        assert!(page.path("out/splash").join(file).is_file(), "{file}");
    }
}

/// Cells of a table row.
fn cells(line: &str) -> Option<Vec<&str>> {
    let row = line.strip_prefix('|')?.strip_suffix('|')?;
    Some(row.split('|').map(str::trim).collect())
}

/// Text in backquotes.
fn code(cell: &str) -> Option<&str> {
    cell.strip_prefix('`')?.strip_suffix('`')
}

#[test]
fn the_commands_for_fsi_run() {
    let page = Page::open("fsi.md");
    let blocks = page.blocks();
    let (_, scene) = blocks.iter().find(|(kind, _)| *kind == "toml").unwrap();
    fs::write(page.path("slab.toml"), scene).unwrap();
    let has_gpu = gpu().is_some();
    let mut run = Vec::new();
    for command in page.commands() {
        let short = match command.split_whitespace().nth(1).unwrap() {
            "run" | "converge" => "--frames 2",
            "export" => "--backend cpu",
            "compare" if has_gpu => "--scale 0.5",
            "compare" => continue,
            _ => "",
        };
        // The last one counts.
        let command = command.replace("--frames 12", "--frames 1");
        page.run(&command, short, 0);
        run.push(command);
    }
    let n_in_blocks = run.len();
    assert!(n_in_blocks >= 4 + usize::from(has_gpu), "{run:?}");
    for file in ["out/slab/probes.csv", "out/slab_converge/convergence.csv", "system/spd.mtx"] {
        assert!(page.path(file).is_file(), "{file}");
    }
    // Tables: a heading says what stands before the arguments, or the first cell is the exit code.
    let mut before = None;
    for line in page.text.lines() {
        let Some(cells) = cells(line) else {
            before = None;
            continue;
        };
        let heading = cells.iter().find_map(|cell| cell.strip_prefix("command after "));
        if let Some(command) = heading {
            before = Some(code(command).unwrap());
        } else if let (Some(before), Some(arguments)) = (before, cells.get(1).and_then(|cell| code(cell))) {
            let command = format!("{before} {arguments}");
            page.run(&command, "--frames 1", 0);
            run.push(command);
        } else if let (Ok(exit), Some(command)) = (cells[0].parse(), cells.last().and_then(|cell| code(cell))) {
            // A collapse takes the time it takes.
            page.run(command, "", exit);
            run.push(command.to_owned());
        }
    }
    assert!(run.len() >= n_in_blocks + 4 + 4, "{run:?}");
}
