//! `report`: one page with everything in it, whatever the tables hold; refusals that name the file.

use std::fs;

use cutwater::measure::report::{Contents, PAGE, report};

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
    let drawn = "<svg xmlns=\"http://www.w3.org/2000/svg\"><path d=\"M0 0\"/></svg>";
    fs::write(bench.join("solve.svg"), drawn).unwrap();
    // More rows and pictures than anybody reads.
    let rows: String = (0..1000).map(|row| format!("{row},{row}.5\n")).collect();
    fs::write(dir.join("run/steps.csv"), format!("step,t\n{rows}")).unwrap();
    for frame in 0..9 {
        let name = format!("run/preview/frame_{frame}.png");
        fs::write(dir.join(name), [0x89, b'P', b'N', b'G', frame]).unwrap();
    }
    fs::write(frames.join("not_shown.csv"), "a\n1\n").unwrap();
    let contents = report(dir).unwrap();
    let expected = Contents {
        folders: 3,
        tables: 2,
        pictures: 4,
    };
    assert_eq!(contents, expected);
    let page = fs::read_to_string(dir.join(PAGE)).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>"));
    for part in [
        "an &lt;adapter&gt;",
        "copy_bandwidth.median",
        "0.12346",
        "1.000e-9",
        "&lt;script&gt;alert(1)&lt;/script&gt;",
        drawn,
        "bench &lt;solve&gt;",
        "600 more rows",
        "frame_8.png",
    ] {
        assert!(page.contains(part), "{part}");
    }
    for part in [
        "<script>",
        "not_shown",
        "frame_1.png",
        "http://cdn",
        "src=\"/",
    ] {
        assert!(!page.contains(part), "{part}");
    }
    assert_eq!(page.matches("data:image/png;base64,").count(), 3);
    // Again, with the page itself in the folder: the same.
    assert_eq!(report(dir).unwrap(), expected);
}

#[test]
fn nothing_and_broken_tables_are_refused() {
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
    let error = report(&dir.join("nowhere")).unwrap_err();
    assert!(error.to_string().contains("no such folder"), "{error}");
}
