//! The pages tell the truth: links lead somewhere, tests that are named exist, scenes load and are all listed, tables are what was measured.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use cutwater::scene::Scene;

use crate::output::python_with;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn names(folder: &str, extension: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|end| end == extension));
    assert!(!paths.is_empty(), "no .{extension} in {folder}");
    paths
}

/// The anchors of a page, as GitHub makes them of its headings.
fn anchors(page: &str) -> Vec<String> {
    let headings = page
        .lines()
        .filter_map(|line| line.trim_start_matches('#').strip_prefix(' ').filter(|_| line.starts_with('#')));
    let anchor = |heading: &str| {
        let kept =
            heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect::<String>();
        kept.replace(' ', "-")
    };
    headings.map(anchor).collect()
}

#[test]
fn links_lead_somewhere() {
    let mut pages = names("docs", "md");
    pages.extend(names("docs/measured", "md"));
    pages.extend(["README.md", "ARCHITECTURE.md", "CHANGELOG.md"].map(|page| root().join(page)));
    for page in pages {
        let text = fs::read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).map(|rest| rest.split(')').next().unwrap()) {
            if link.starts_with("https://") {
                continue;
            }
            let (file, anchor) = link.split_once('#').map_or((link, None), |(file, anchor)| (file, Some(anchor)));
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: no {link}", page.display());
            if let Some(anchor) = anchor {
                let known = anchors(&fs::read_to_string(&target).unwrap());
                assert!(known.iter().any(|known| known == anchor), "{}: no {link} among {known:?}", page.display());
            }
        }
    }
}

#[test]
fn the_list_of_tests_names_tests_that_exist() {
    let page = fs::read_to_string(root().join("docs/tests.md")).unwrap();
    let named = page.split('`').filter_map(|word| word.split_once("::")).filter(|(module, _)| !module.contains(' '));
    let read = |module: &str| fs::read_to_string(root().join(format!("tests/suite/{module}.rs"))).ok();
    for module in page.split('`').filter(|word| word.starts_with("twin_") && !word.contains("::")) {
        assert!(read(module).is_some(), "docs/tests.md: no tests {module}");
    }
    let mut n = 0;
    for (module, test) in named {
        let source = read(module).unwrap_or_default();
        assert!(source.contains(&format!("#[test]\nfn {test}()")), "docs/tests.md: no test {module}::{test}");
        n += 1;
    }
    assert!(n > 0, "docs/tests.md names no test");
}

#[test]
fn the_list_of_scenes_is_whole() {
    let page = fs::read_to_string(root().join("docs/scenes.md")).unwrap();
    for scene in names("scenes", "toml") {
        let name = scene.file_stem().unwrap().to_str().unwrap();
        assert!(page.contains(&format!("| `{name}` |")), "docs/scenes.md: no scene {name}");
    }
}

#[test]
fn the_scenes_of_the_pages_load() {
    for page in ["README.md", "docs/scene.md"] {
        let text = fs::read_to_string(root().join(page)).unwrap();
        let blocks = text.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap());
        let mut n = 0;
        for block in blocks {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("page.toml");
            fs::write(&file, block).unwrap();
            Scene::load(&file, &[], 1.0).unwrap_or_else(|error| panic!("{page}: {error}"));
            n += 1;
        }
        assert!(n > 0, "{page} has no scene");
    }
}

/// The tables of the pages have the numbers of docs/measured.
#[test]
fn tables_are_those_that_were_measured() {
    let script = root().join(".ci/tables.py");
    // Not in the published package.
    if !script.exists() {
        return;
    }
    let Some(python) = python_with("csv") else {
        return;
    };
    for mode in ["--test", "--check"] {
        let output = Command::new(&python).arg(&script).arg(mode).output().unwrap();
        assert!(
            output.status.success(),
            "{mode}: {}{}",
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
    }
}
