//! `report`: one page with everything in it, whatever the tables hold; refusals that name the file.

use std::fs;
use std::path::Path;

use cutwater::measure::agreement::agreement;
use cutwater::measure::insert::insert;
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

const DOCUMENT: &str = "# Speed
<!-- table
{\"file\": \"solve/solve_growth.csv\", \"where\": {\"precision\": \"mixed\", \"tolerance\": 1e-8},
 \"columns\": [[\"cells\", \"{grid}\"], [\"seconds (least)\", \"{median} ({min})\"], [\"order\", \"{order}\"]]}
-->
old
<!-- end of table -->
After it.
";

#[test]
fn tables_of_documents_are_written_anew() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("results");
    fs::create_dir_all(dir.join("solve")).unwrap();
    let table = "grid,precision,tolerance,median,min,order\n\
                 20,mixed,0.00000001,0.123456,0.1,\n\
                 20,f32,1e-8,9,9,9\n\
                 40,mixed,1e-4,9,9,9\n\
                 80,mixed,1e-8,12.3456,0.00001,1.5\n";
    fs::write(dir.join("solve/solve_growth.csv"), table).unwrap();
    let json = "{\"cutwater\": \"0.1.0\", \"adapter\": \"an adapter\", \"measured\": \"2026-11-22T05:00:00Z\", \
                \"threads\": 2, \"load\": 0.5, \"copy_bandwidth\": {\"median\": 2.5e9}}";
    fs::write(dir.join("solve/solve.json"), json).unwrap();
    let document = folder.path().join("speed.md");
    fs::write(&document, DOCUMENT).unwrap();
    let expected = DOCUMENT.replace(
        "old\n",
        "| cells | seconds (least) | order |\n|---|---|---|\n\
         | 20 | 0.123 (0.100) |  |\n| 80 | 12.3 (1e-5) | 1.50 |\n\n\
         *2026-11-22, cutwater 0.1.0, an adapter, copy bandwidth 2.5 GB/s, 2 CPU threads at a load of 0.5.*\n",
    );
    // Once more changes nothing.
    for _ in 0..2 {
        let tables = insert(&dir, &document).unwrap();
        assert_eq!((tables.written, tables.left.len()), (1, 0));
        assert_eq!(fs::read_to_string(&document).unwrap(), expected);
    }
    // The CPU's model where it is told, no adapter where there was none.
    let threads = "2 CPU threads";
    let with_model = "2 CPU threads (a CPU)";
    let adapter = ", an adapter, copy bandwidth 2.5 GB/s";
    let of_model = json.replace("\"threads\"", "\"cpu\": \"a CPU\", \"threads\"");
    let of_cpu = "{\"cutwater\": \"0.1.0\", \"measured\": \"2026-11-22T05:00:00Z\", \"cpu\": \"a CPU\", \"threads\": 2, \
                  \"load\": 0.5}";
    let told = expected.replace(threads, with_model);
    for (json, expected) in [
        (of_cpu, &told.replace(adapter, "")),
        (of_model.as_str(), &told),
        (json, &expected),
    ] {
        fs::write(dir.join("solve/solve.json"), json).unwrap();
        insert(&dir, &document).unwrap();
        assert_eq!(&fs::read_to_string(&document).unwrap(), expected);
    }
    for (broken, line, told) in [
        (
            DOCUMENT.replace("{grid}", "{grids}"),
            2,
            "no column \"grids\"",
        ),
        (
            DOCUMENT.replace("\"precision\"", "\"precisions\""),
            2,
            "no column \"precisions\"",
        ),
        (
            DOCUMENT.replace("columns", "colums"),
            2,
            "unknown field `colums`",
        ),
        (
            DOCUMENT.replace("<!-- end of table -->\n", ""),
            2,
            "does not end",
        ),
        (
            DOCUMENT
                .replace("-->\nold", "old")
                .replace("<!-- end of table -->\n", ""),
            2,
            "does not end",
        ),
        ("# Nothing\n".to_owned(), 1, "no table"),
    ] {
        fs::write(&document, &broken).unwrap();
        let error = insert(&dir, &document).unwrap_err();
        let place = format!("speed.md:{line}: ");
        let text = error.to_string();
        assert!(
            text.contains(&place) && text.contains(told),
            "{told}: {text}"
        );
        assert_eq!(error.exit_code(), 2);
        assert_eq!(
            fs::read_to_string(&document).unwrap(),
            broken,
            "left as it was"
        );
    }
    // What was not measured this time is left as it is, unless that is all.
    let other = DOCUMENT.replace("solve/solve_", "solve/other_");
    fs::write(&document, format!("{DOCUMENT}{other}")).unwrap();
    let tables = insert(&dir, &document).unwrap();
    assert_eq!(
        (tables.written, &tables.left[..]),
        (1, &["solve/other_growth.csv".to_owned()][..])
    );
    assert_eq!(
        fs::read_to_string(&document).unwrap(),
        format!("{expected}{other}")
    );
    fs::write(&document, &other).unwrap();
    let text = insert(&dir, &document).unwrap_err().to_string();
    assert!(
        text.contains("results: no table is there") && text.contains("speed.md"),
        "{text}"
    );
}

#[test]
fn tables_without_rows_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("results");
    fs::create_dir_all(dir.join("solve")).unwrap();
    let table = dir.join("solve/solve_growth.csv");
    let document = folder.path().join("speed.md");
    let refused = |text: &str, told: &str| {
        fs::write(&document, text).unwrap();
        let error = insert(&dir, &document).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(told), "{told}: {error}");
        assert_eq!(fs::read_to_string(&document).unwrap(), text);
    };
    for rows in ["", "20,f32,1e-8,9,9,9\n"] {
        let heads = "grid,precision,tolerance,median,min,order";
        fs::write(&table, format!("{heads}\n{rows}")).unwrap();
        fs::write(&document, DOCUMENT).unwrap();
        let tables = insert(&dir, &document).unwrap();
        assert_eq!((tables.written, tables.left.len()), (1, 0));
        assert_eq!(tables.empty, ["solve/solve_growth.csv"]);
        assert_eq!(
            fs::read_to_string(&document).unwrap(),
            DOCUMENT.replace("old\n", "*None.*\n")
        );
        for (name, other, told) in [
            ("{grid}", "{grids}", "no column \"grids\""),
            ("\"precision\"", "\"precisions\"", "no column \"precisions\""),
            ("({min})", "({min)", "does not close"),
        ] {
            refused(&DOCUMENT.replace(name, other), told);
        }
    }
    // What has no head may have any columns.
    fs::write(&table, "").unwrap();
    refused(DOCUMENT, "solve_growth.csv: it is empty");
}

#[test]
fn two_runs_are_compared_number_by_number() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    let write = |dir: &Path, table: &str| {
        fs::create_dir_all(dir.join("solve")).unwrap();
        fs::write(dir.join("solve/solve.csv"), table).unwrap();
    };
    let heads = "grid,note,seconds_median,seconds_min,seconds_max,cells_per_second,residual\n";
    write(
        &first,
        &format!("{heads}20,a,1,0.9,1.2,10,1e-9\n40,,4,3.9,4.1,10,0\n"),
    );
    // Spreads that touch, and that do not; a rate within 1.5 / 0.9, and one beyond 6.1 / 3.9; a residual that is not the same, though as near.
    write(
        &second,
        &format!("{heads}20,a,1.4,1.2,1.5,16,1e-9\n40,,6,5.9,6.1,15.7,1e-12\n"),
    );
    // Quartiles around 0, a time without a spread, and powers, which are not compared.
    for (dir, low, seconds) in [(&first, -2, 5), (&second, 1, 7)] {
        let table = format!("added,added_low,added_high,seconds\n0,{low},1,{seconds}\n");
        fs::write(dir.join("effects.csv"), table).unwrap();
        fs::write(dir.join("solve_growth.csv"), format!("exponent\n{low}\n")).unwrap();
    }
    let columns = agreement(&first, &second).unwrap();
    let said = |name: &str| {
        let row = columns.iter().find(|row| row.column == name).unwrap();
        (row.rows, row.same, row.agree)
    };
    assert_eq!(columns.len(), 7, "{columns:?}");
    assert_eq!(said("grid"), (2, 2, Some(2)));
    assert_eq!(said("note"), (1, 1, Some(1)));
    assert_eq!(said("seconds_median"), (2, 0, Some(1)));
    assert_eq!(said("cells_per_second"), (2, 0, Some(1)));
    assert_eq!(said("residual"), (2, 1, Some(1)));
    assert_eq!(said("added"), (1, 1, Some(1)));
    assert_eq!(said("seconds"), (1, 0, None));
    assert_eq!(columns.iter().filter(|row| row.agrees()).count(), 4);
    let seconds = columns
        .iter()
        .find(|row| row.column == "seconds_median")
        .unwrap();
    assert_eq!(
        [
            seconds.ratio_least,
            seconds.ratio_median,
            seconds.ratio_most
        ],
        [Some(1.4), Some(1.45), Some(1.5)]
    );
    let table = fs::read_to_string(first.join("agreement.csv")).unwrap();
    assert_eq!(table.lines().count(), 8);
    // Not itself, the second time.
    assert_eq!(agreement(&first, &second).unwrap(), columns);

    let refused = |part: &str| {
        let error = agreement(&first, &second).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(part), "{error}");
    };
    write(&second, heads);
    refused("number of its rows");
    fs::remove_dir_all(&second).unwrap();
    refused("no such folder");
    fs::create_dir(&second).unwrap();
    refused("no table of the name");
}
