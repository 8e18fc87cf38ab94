//! `report`: one page with everything in it, whatever the tables hold; refusals that name the file.

use std::fs;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use cutwater::output::manifest::{Manifest, RunOptions};
use cutwater::output::report::{Contents, PAGE, report};
use cutwater::scene::Scene;

use crate::common::assert_has;

/// A PNG file of one pixel, an animation where it is to be several greys.
fn picture(greys: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 1, 1);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    if greys.len() > 1 {
        encoder.set_animated(greys.len() as u32, 0).unwrap();
    }
    let mut writer = encoder.write_header().unwrap();
    for &grey in greys {
        writer.write_image_data(&[grey]).unwrap();
    }
    writer.finish().unwrap();
    bytes
}

#[test]
fn a_page_holds_everything() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let bench = dir.join("bench <solve>");
    let frames = dir.join("run/frames");
    for inner in [&bench, &frames, &dir.join("run/preview")] {
        fs::create_dir_all(inner).unwrap();
    }
    fs::write(
        bench.join("solve.json"),
        "{\"adapter\": \"an <adapter>\", \"copy_bandwidth\": {\"median\": 2.5e9}, \"rows\": [1]}",
    )
    .unwrap();
    let table = "grid,seconds,note\n20,0.123456789,<script>alert(1)</script>\n40,1e-9,\n";
    fs::write(bench.join("solve.csv"), table).unwrap();
    // As an image it runs nothing.
    let drawn = "<svg xmlns=\"http://www.w3.org/2000/svg\"><script>alert(2)</script></svg>";
    fs::write(bench.join("solve.svg"), drawn).unwrap();
    // More rows and pictures than anybody reads.
    let rows: String = (0..1000).map(|row| format!("{row},{row}.5\n")).collect();
    fs::write(dir.join("run/steps.csv"), format!("step,t\n{rows}")).unwrap();
    for frame in 0..9 {
        let name = format!("run/preview/frame_{frame}.png");
        fs::write(dir.join(name), picture(&[frame])).unwrap();
    }
    fs::write(frames.join("not_shown.csv"), "a\n1\n").unwrap();
    let contents = report(dir).unwrap();
    let expected = Contents { folders: 3, tables: 2, pictures: 4 };
    assert_eq!(contents, expected);
    let page = fs::read_to_string(dir.join(PAGE)).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>"));
    for part in [
        "an &lt;adapter&gt;",
        "copy_bandwidth.median",
        "0.12346",
        "1.000e-9",
        "&lt;script&gt;alert(1)&lt;/script&gt;",
        &STANDARD.encode(drawn),
        "bench &lt;solve&gt;",
        "600 more rows",
        "frame_8.png",
    ] {
        assert!(page.contains(part), "{part}");
    }
    for part in ["<script>", "not_shown", "frame_1.png", "http://cdn", "src=\"/"] {
        assert!(!page.contains(part), "{part}");
    }
    assert_eq!(page.matches("data:image/png;base64,").count(), 3);
    // Again, with the page itself in the folder: the same.
    assert_eq!(report(dir).unwrap(), expected);
}

#[test]
fn nothing_and_broken_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let refused = |part: &str| {
        let error = report(dir).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(part), "{error}");
    };
    refused("no table and no picture");
    fs::write(dir.join("broken.csv"), "a,b\n1\n").unwrap();
    refused("broken.csv");
    fs::write(dir.join("broken.csv"), "a,b\n1,2\n").unwrap();
    fs::write(dir.join("broken.json"), "{").unwrap();
    refused("broken.json");
    fs::remove_file(dir.join("broken.json")).unwrap();
    let whole = picture(&[7]);
    let mut changed = whole.clone();
    // The last byte of its data, before two checksums and the end.
    changed[whole.len() - 21] ^= 1;
    let drawing = "<!DOCTYPE svg><svg xmlns=\"http://www.w3.org/2000/svg\"><g fill=\"url(#p)\"></g></svg>";
    let files: [(&str, &[u8], &str); 13] = [
        ("steps.csv", b"", "it is empty"),
        ("blank.csv", b"\n\n", "it is empty"),
        ("quote.csv", b"a,b\n1,\"2\n3,4\n", "the last quotation mark"),
        ("quote.csv", b"a,b\n1,\"2\"\"", "the last quotation mark"),
        ("quote.csv", b"a,\"b\n", "the last quotation mark"),
        ("p.png", b"", ""),
        ("p.png", b"garbage", ""),
        ("p.png", &whole[..whole.len() - 1], ""),
        ("p.png", &changed, ""),
        ("p.svg", b"", ""),
        ("p.svg", b"<svg", ""),
        ("p.svg", &drawing.as_bytes()[..drawing.len() - 1], ""),
        ("p.svg", b"<html></html>", "its root"),
    ];
    for (name, bytes, told) in files {
        fs::write(dir.join(name), bytes).unwrap();
        refused(&format!("{name}: cannot be read: {told}"));
        refused("move it elsewhere");
        fs::remove_file(dir.join(name)).unwrap();
    }
    assert!(!dir.join(PAGE).exists());
    // Line breaks within quotes, also at the end, are of a cell.
    fs::write(dir.join("quote.csv"), "a,\"b\nc\"\n1,\"2\n\"").unwrap();
    fs::write(dir.join("p.png"), picture(&[7, 8])).unwrap();
    fs::write(dir.join("p.svg"), drawing).unwrap();
    assert_eq!(report(dir).unwrap().tables, 2);
    let error = report(&dir.join("nowhere")).unwrap_err();
    assert!(error.to_string().contains("no such folder"), "{error}");
}

/// The first sub-step tells the columns: a run that failed in it does not keep those beside it from the page.
#[test]
fn a_run_before_its_first_sub_step_has_no_columns() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/dam_break_liquid.toml");
    let scene = Scene::load(&path, &[], 0.25).unwrap();
    let options = RunOptions { backend: "cpu".to_owned(), frames: 1, scale: 0.25, overrides: Vec::new() };
    let mut manifest = Manifest::new(&scene, options, None);
    manifest.write(run).unwrap();
    fs::write(run.join("steps.csv"), "").unwrap();
    assert_eq!(report(run).unwrap().tables, 1);
    manifest.progress.steps = 1;
    manifest.write(run).unwrap();
    let error = report(run).unwrap_err().to_string();
    assert_has(&error, &["steps.csv: cannot be read: it is empty"]);
}
