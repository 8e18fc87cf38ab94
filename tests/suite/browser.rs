//! The page of `report` as a browser lays it out: the results of a run and of every bench, with nothing missing, cut off, written over each
//! other or fetched from elsewhere. The pictures of the documents, of whole benches, stand among them.
//!
//! `CUTWATER_BROWSER` names a headless Chromium (default `chromium-headless-shell`), `REQUIRE_BROWSER=1` makes a missing one a failure.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::cli::{DAM, folder, says};
use crate::common::gpu;

/// Counts what is on the page and leaves it as text in the page itself. Tables are unfolded first, as a reader does with a click.
const PROBE: &str = "<script>addEventListener('load', () => {
  document.querySelectorAll('details').forEach(fold => fold.open = true);
  const all = (what, where = document) => [...where.querySelectorAll(what)];
  const extent = part => part.getBoundingClientRect();
  const seen = part => extent(part).width > 20 && extent(part).height > 20;
  const inside = (part, whole) => part.left >= whole.left - 1 && part.right <= whole.right + 1
    && part.top >= whole.top - 1 && part.bottom <= whole.bottom + 1;
  // Where letters are: lines of text that touch each other can be read. A tick that is drawn twice in one place is one to the reader.
  const letters = text => {
    const { left, right, top, bottom, width, height } = extent(text), edge = 0.2 * Math.min(width, height);
    return { left: left + edge, right: right - edge, top: top + edge, bottom: bottom - edge, says: text.textContent.trim() };
  };
  const twice = (a, b) => a.says == b.says && Math.hypot(a.left - b.left, a.top - b.top) < 1;
  const overlap = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom && !twice(a, b);
  const overlaps = svg => {
    const texts = all('text', svg).map(letters).filter(text => text.says);
    return texts.flatMap((a, at) => texts.slice(at + 1).filter(b => overlap(a, b)).map(b => `${a.says} | ${b.says}`));
  };
  const found = document.createElement('pre');
  found.id = 'found';
  found.textContent = JSON.stringify({
    sections: all('section').length,
    links: all('nav a').filter(link => document.getElementById(link.hash.slice(1))).length,
    drawings: all('figure > svg').filter(seen).length,
    pictures: all('img').filter(image => image.complete && image.naturalWidth > 1 && seen(image)).length,
    tables: all('table').filter(seen).length,
    ragged: all('tr').filter(row => row.cells.length != row.closest('table').rows[0].cells.length).length,
    tall: all('td').filter(cell => extent(cell).height > 60).length,
    scripts: document.scripts.length - 1,
    overlapping: all('figure').flatMap(figure => all('svg', figure).flatMap(overlaps).map(pair => `${figure.lastElementChild.textContent}: ${pair}`)),
    cut: all('figure > svg').flatMap(svg => all('text', svg).filter(text => !inside(extent(text), extent(svg)))).map(text => text.textContent.trim()),
    unwritten: all('svg text').filter(text => text.textContent.trim() && extent(text).width == 0).length,
    fetched: performance.getEntriesByType('resource').map(entry => entry.name).filter(name => !name.startsWith('data:')),
    sideways: document.documentElement.scrollWidth > document.documentElement.clientWidth,
  });
  document.body.append(found);
})</script>";

/// The browser, or `None` after saying why.
fn browser() -> Option<String> {
    let name = std::env::var("CUTWATER_BROWSER").unwrap_or("chromium-headless-shell".to_owned());
    let problem = match Command::new(&name).arg("--version").output() {
        Ok(output) if output.status.success() => return Some(name),
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    let required = std::env::var("REQUIRE_BROWSER").is_ok_and(|value| value == "1");
    assert!(!required, "REQUIRE_BROWSER=1 and {name} does not run: {problem}");
    eprintln!("skipped for want of {name}: {problem}");
    None
}

/// What the probe finds on a page in a window so many pixels wide.
fn found(browser: &str, page: &Path, width: u32) -> Value {
    // Drawings are images; the probe sees their text where they are parts of the page.
    let text = fs::read_to_string(page).unwrap();
    let mut parts = text.split("<img src=\"data:image/svg+xml;base64,");
    let mut text = parts.next().unwrap().to_owned();
    for part in parts {
        let (data, rest) = part.split_once('"').unwrap();
        text += &String::from_utf8(STANDARD.decode(data).unwrap()).unwrap();
        text += rest.split_once('>').unwrap().1;
    }
    let probed = page.with_file_name("probed.html");
    fs::write(&probed, text.replace("</body>", &format!("{PROBE}</body>"))).unwrap();
    let profile = tempfile::tempdir().unwrap();
    let output = Command::new(browser)
        // The sandbox does not start as root, the usual user in containers; the page is our own.
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--timeout=60000",
            "--dump-dom",
        ])
        .arg(format!("--window-size={width},900"))
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("file://{}", probed.display()))
        .output()
        .unwrap();
    let laid_out = String::from_utf8(output.stdout).unwrap();
    let found = laid_out.split("<pre id=\"found\">").nth(1);
    let found = found.unwrap_or_else(|| panic!("no page came of it: {}", String::from_utf8_lossy(&output.stderr)));
    let found = found.split("</pre>").next().unwrap();
    serde_json::from_str(&found.replace("&gt;", ">").replace("&lt;", "<").replace("&amp;", "&")).unwrap()
}

/// Commands that fill a folder each, all on the smallest there is to measure.
const COMMANDS: [(&str, &str); 7] = [
    ("run", "run dam.toml --backend cpu --frames 3 --preview"),
    ("plots", "plot results/run"),
    ("solve", "bench solve --formulation pressure --grids 8,10 --repeats 1"),
    ("effects", "bench effects dam.toml --frames 1"),
    (
        "accuracy",
        "bench accuracy dam.toml --frames 1 --grids 10 --precision mixed --preconditioner multigrid --tolerance 1e-3,1e-6 --repeats 1",
    ),
    ("step", "bench step dam.toml --scale 0.5,1 --frames 2 --repeats 1"),
    ("stability", "bench stability --steps 8 --cases droplet_one,start_spun"),
];
/// A step table whose chart has labels of 16 characters, and a tick near the end of the axis of times.
const EDGES: &str = "step,t,kinetic_energy
0,0.004,-1.84129454e-4
1,0.0106668,-1.84129447e-4
";
/// Folders of pictures of whole benches, below `docs`: the map of stability with all of its cases, and the glance of the validation, among them.
fn measured() -> Vec<String> {
    let entries = fs::read_dir(documents().join("measured")).unwrap();
    let folders = entries.map(|entry| entry.unwrap().path());
    let drawn = folders.filter(|folder| folder.is_dir() && !files(folder, "svg").is_empty());
    let names = drawn.map(|folder| folder.file_name().unwrap().to_str().unwrap().to_owned());
    names.map(|name| format!("measured/{name}")).collect()
}

fn documents() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs")
}

/// A folder `results` with what all commands leave, and the pictures of the documents.
fn results() -> TempDir {
    let folder = folder(DAM);
    for (name, command) in COMMANDS {
        says(&folder, &format!("{command} --out results/{name}"));
    }
    for name in measured() {
        let copied = folder.path().join("results").join(&name);
        fs::create_dir_all(&copied).unwrap();
        for file in files(&documents().join(&name), "svg") {
            fs::copy(&file, copied.join(file.file_name().unwrap())).unwrap();
        }
    }
    fs::create_dir(folder.path().join("edges")).unwrap();
    fs::write(folder.path().join("edges/steps.csv"), EDGES).unwrap();
    says(&folder, "plot edges --out results/edges");
    says(&folder, "report results");
    folder
}

/// Files of a kind in a folder.
fn files(folder: &Path, kind: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension() == Some(kind.as_ref()));
    paths
}

#[test]
fn a_report_is_whole_in_a_browser() {
    let (Some(browser), Some(_)) = (browser(), gpu()) else {
        return;
    };
    let folder = results();
    let results = folder.path().join("results");
    let names = COMMANDS.map(|(name, _)| name);
    let measured = measured();
    let folders = names.into_iter().chain(["edges"]);
    let folders = folders.chain(measured.iter().map(String::as_str));
    let of_kind = |kind: &str| {
        let counts = folders.clone().map(|name| files(&results.join(name), kind).len());
        counts.sum::<usize>()
    };
    let (drawings, tables) = (of_kind("svg"), of_kind("csv"));
    // Each bench has a picture and a table, and the documents have those of whole benches.
    for name in &names[1..] {
        let inner = results.join(name);
        assert!(!files(&inner, "svg").is_empty(), "no picture of {name}");
        let plots = *name == "plots";
        assert!(plots || !files(&inner, "csv").is_empty(), "no table of {name}");
    }
    for picture in ["stability/stability.svg", "validation/glance.svg"] {
        let picture = results.join("measured").join(picture);
        assert!(picture.is_file(), "{}", picture.display());
    }
    for width in [1280, 700] {
        let page = found(&browser, &results.join("report.html"), width);
        // The preview and the edges have sections of their own.
        let sections = COMMANDS.len() + measured.len() + 2;
        let expected = json!({
            "sections": sections,
            "links": sections,
            "drawings": drawings,
            "pictures": 3,
            "tables": tables,
            "ragged": 0,
            "tall": 0,
            "scripts": 0,
            "overlapping": [],
            "cut": [],
            "unwritten": 0,
            "fetched": [],
            "sideways": false,
        });
        assert_eq!(page, expected, "{width} pixels wide");
    }
}
