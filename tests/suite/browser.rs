//! The page of `report` as a browser lays it out: the results of real commands, with nothing missing, cut off or fetched from elsewhere.
//!
//! `CUTWATER_BROWSER` names a headless Chromium (default `chromium-headless-shell`), `REQUIRE_BROWSER=1` makes a missing one a failure.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

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
    assert!(
        !required,
        "REQUIRE_BROWSER=1 and {name} does not run: {problem}"
    );
    eprintln!("skipped for want of {name}: {problem}");
    None
}

/// What the probe finds on a page in a window so many pixels wide.
fn found(browser: &str, page: &Path, width: u32) -> Value {
    let text = fs::read_to_string(page).unwrap();
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
    let found = found.unwrap_or_else(|| {
        panic!(
            "no page came of it: {}",
            String::from_utf8_lossy(&output.stderr)
        )
    });
    let found = found.split("</pre>").next().unwrap();
    serde_json::from_str(
        &found
            .replace("&gt;", ">")
            .replace("&lt;", "<")
            .replace("&amp;", "&"),
    )
    .unwrap()
}

#[test]
fn a_report_is_whole_in_a_browser() {
    let (Some(browser), Some(_)) = (browser(), gpu()) else {
        return;
    };
    let folder = folder(DAM);
    says(
        &folder,
        "run dam.toml --backend cpu --frames 3 --preview --out results/run",
    );
    says(&folder, "plot results/run --out results/plots");
    says(
        &folder,
        "bench thesis --tables 6.5 --grids 5,10 --repeats 1 --out results/thesis",
    );
    says(
        &folder,
        "bench solve --formulation pressure --grids 8,10 --repeats 1 --out results/solve",
    );
    says(&folder, "report results");
    let results = folder.path().join("results");
    let of_kind = |kind: &str| {
        let paths = ["run", "plots", "thesis", "solve"].map(|inner| results.join(inner));
        let files = paths.iter().flat_map(|path| fs::read_dir(path).unwrap());
        files
            .filter(|file| file.as_ref().unwrap().path().extension() == Some(kind.as_ref()))
            .count()
    };
    let (drawings, tables) = (of_kind("svg"), of_kind("csv"));
    assert!(
        drawings >= 4 && tables >= 6,
        "{drawings} drawings, {tables} tables"
    );
    for width in [1280, 700] {
        let page = found(&browser, &results.join("report.html"), width);
        let expected = json!({
            // The preview has one of its own.
            "sections": 5,
            "links": 5,
            "drawings": drawings,
            "pictures": 3,
            "tables": tables,
            "ragged": 0,
            "tall": 0,
            "cut": [],
            "unwritten": 0,
            "fetched": [],
            "sideways": false,
        });
        assert_eq!(page, expected, "{width} pixels wide");
    }
}
