//! `report`: one page with everything in it, whatever the tables hold; refusals that name the file.

use std::fs;
use std::path::Path;

use cutwater::Error;
use cutwater::measure::agreement::agreement;
use cutwater::measure::insert::{Inserted, insert};
use cutwater::measure::report::{Contents, PAGE, report};
use cutwater::output::manifest::{Manifest, RunOptions};
use cutwater::scene::Scene;

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
    let drawn = "<svg xmlns=\"http://www.w3.org/2000/svg\"><path d=\"M0 0\"/></svg>";
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
    let drawing = "<!DOCTYPE svg><svg xmlns=\"http://www.w3.org/2000/svg\"><g fill=\"url(#p)\"></g><a href=\"#g\"/></svg>";
    let files: [(&str, &[u8], &str); 24] = [
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
        ("p.svg", b"<svg><script>1</script></svg>", "it has a script"),
        ("p.svg", b"<svg><foreignObject/></svg>", "it has a foreign"),
        ("p.svg", b"<svg><SCRIPT>1</SCRIPT></svg>", "it has a SCRIPT"),
        (
            "p.svg",
            b"<svg><?x ><script>1</script>?></svg>",
            "it has a processing",
        ),
        (
            "p.svg",
            b"<svg><set attributeName=\"href\"/></svg>",
            "it has a set",
        ),
        (
            "p.svg",
            b"<svg><style>@import 'a'</style></svg>",
            "it has a style",
        ),
        ("p.svg", b"<svg fill=\"URL('//a/b')\"/>", "it has fill"),
        ("p.svg", b"<svg><img src=\"a.png\"/></svg>", "it has src"),
        ("p.svg", b"<svg onload=\"a()\"/>", "it has onload"),
        (
            "p.svg",
            b"<svg><a href=\"javascript:a()\"/></svg>",
            "it has href",
        ),
        (
            "p.svg",
            b"<svg xmlns:x=\"http://www.w3.org/1999/xlink\"><image x:href=\"//a/b.png\"/></svg>",
            "it has href",
        ),
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
    let options = RunOptions {
        backend: "cpu".to_owned(),
        frames: 1,
        scale: 0.25,
        overrides: Vec::new(),
    };
    let mut manifest = Manifest::new(&scene, options, None);
    manifest.write(run).unwrap();
    fs::write(run.join("steps.csv"), "").unwrap();
    assert_eq!(report(run).unwrap().tables, 1);
    manifest.progress.steps = 1;
    manifest.write(run).unwrap();
    let error = report(run).unwrap_err().to_string();
    assert!(
        error.contains("steps.csv: cannot be read: it is empty"),
        "{error}"
    );
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

fn insert_into(dir: &Path, document: &Path) -> Result<Inserted, Error> {
    insert(dir, &[document]).map(|mut tables| tables.remove(0))
}

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
        let tables = insert_into(&dir, &document).unwrap();
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
        insert_into(&dir, &document).unwrap();
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
        let error = insert_into(&dir, &document).unwrap_err();
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
    let tables = insert_into(&dir, &document).unwrap();
    assert_eq!(
        (tables.written, &tables.left[..]),
        (1, &["solve/other_growth.csv".to_owned()][..])
    );
    assert_eq!(
        fs::read_to_string(&document).unwrap(),
        format!("{expected}{other}")
    );
    // Of several documents one may have nothing.
    let beside = folder.path().join("beside.md");
    fs::write(&beside, &other).unwrap();
    let tables = insert(&dir, &[&beside, &document]).unwrap();
    assert_eq!(
        [tables[0].written, tables[0].left.len(), tables[1].written],
        [0, 1, 1]
    );
    assert_eq!(fs::read_to_string(&beside).unwrap(), other);
    fs::write(&document, &other).unwrap();
    let text = insert_into(&dir, &document).unwrap_err().to_string();
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
        let error = insert_into(&dir, &document).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(told), "{told}: {error}");
        assert_eq!(fs::read_to_string(&document).unwrap(), text);
    };
    for rows in ["", "20,f32,1e-8,9,9,9\n"] {
        let heads = "grid,precision,tolerance,median,min,order";
        fs::write(&table, format!("{heads}\n{rows}")).unwrap();
        fs::write(&document, DOCUMENT).unwrap();
        let tables = insert_into(&dir, &document).unwrap();
        assert_eq!((tables.written, tables.left.len()), (1, 0));
        assert_eq!(tables.empty, ["solve/solve_growth.csv"]);
        assert_eq!(
            fs::read_to_string(&document).unwrap(),
            DOCUMENT.replace("old\n", "*None.*\n")
        );
        for (name, other, told) in [
            ("{grid}", "{grids}", "no column \"grids\""),
            (
                "\"precision\"",
                "\"precisions\"",
                "no column \"precisions\"",
            ),
            ("({min})", "({min)", "does not close"),
        ] {
            refused(&DOCUMENT.replace(name, other), told);
        }
    }
    // What has no head may have any columns.
    fs::write(&table, "").unwrap();
    refused(DOCUMENT, "solve_growth.csv: it is empty");
    fs::write(&table, "grid\n\"20\n").unwrap();
    refused(DOCUMENT, "quotation mark is not closed");
}

#[test]
fn two_runs_are_compared_number_by_number() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    let write = |dir: &Path, table: &str| {
        fs::create_dir_all(dir.join("solve")).unwrap();
        fs::write(dir.join("solve/solve.csv"), table).unwrap();
    };
    let heads = "grid,bricks,seconds_median,seconds_min,seconds_max,cells_per_second,residual_p\n";
    write(
        &first,
        &format!("{heads}20,2,1,0.9,1.2,10,1e-9\n40,,4,3.9,4.1,10,0\n"),
    );
    // Spreads that touch, and that do not; a rate within 1.5 / 0.9, and one beyond 6.1 / 3.9; a residual that is not the same, though as near.
    write(
        &second,
        &format!("{heads}20,2,1.4,1.2,1.5,16,1e-9\n40,,6,5.9,6.1,15.7,1e-12\n"),
    );
    // Quartiles around 0, a time without a spread, and powers, which are not compared.
    for (dir, low, seconds) in [(&first, -2, 5), (&second, 1, 7)] {
        let heads = "seconds_with,seconds_added,seconds_added_low,seconds_added_high";
        let table = format!("{heads}\n{seconds},0,{low},1\n");
        fs::write(dir.join("effects.csv"), table).unwrap();
        fs::write(dir.join("solve_growth.csv"), format!("exponent\n{low}\n")).unwrap();
    }
    let found = agreement(&first, &second).unwrap();
    let columns = &found.columns;
    let row = |name: &str| columns.iter().find(|row| row.column == name).unwrap();
    assert_eq!(columns.len(), 7, "{columns:?}");
    for (column, said) in [
        ("grid", [2, 2, 2, 0, 0]),
        ("bricks", [1, 1, 1, 0, 0]),
        ("seconds_median", [2, 0, 1, 1, 0]),
        ("cells_per_second", [2, 0, 1, 1, 0]),
        ("residual_p", [2, 1, 1, 1, 0]),
        ("seconds_added", [1, 1, 1, 0, 0]),
        ("seconds_with", [1, 0, 0, 0, 1]),
    ] {
        let row = row(column);
        let found = [row.rows, row.same, row.agree, row.differ, row.unjudged];
        assert_eq!(found, said, "{column}");
    }
    let seconds = row("seconds_median");
    assert_eq!(
        [
            seconds.ratio_least,
            seconds.ratio_median,
            seconds.ratio_most
        ],
        [Some(1.4), Some(1.45), Some(1.5)]
    );
    let verdict = found.verdict().unwrap_err();
    assert_eq!(verdict.exit_code(), 1, "{verdict}");
    assert!(verdict.to_string().contains("differ: 3;"), "{verdict}");
    let table = fs::read_to_string(first.join("agreement.csv")).unwrap();
    assert_eq!(table.lines().count(), 8);
    // Not itself, the second time.
    assert_eq!(agreement(&first, &second).unwrap(), found);

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

/// Columns of the tables that there are: what follows from times may differ as these do, everything else may not, and what says nothing of how
/// far it spreads is not judged.
#[test]
fn only_what_follows_from_times_may_differ() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    for dir in [&first, &second] {
        fs::create_dir(dir).unwrap();
    }
    // Heads, the rows of both, and how many rows of each column agree, differ and are not judged.
    let cases = [
        (
            "accuracy.csv",
            "tolerance,iterations,seconds_median,seconds_min,seconds_max,speed_over_g_dt",
            ["0.01,12,1,0.8,1.2,0.5", "0.01,13,1,0.8,1.2,0.6"],
            "tolerance 1 0 0, iterations 0 1 0, seconds_median 1 0 0, speed_over_g_dt 0 1 0",
        ),
        // From spreads of differences nothing follows for times.
        (
            "effects.csv",
            "seconds_with,seconds_without,seconds_added,seconds_added_low,seconds_added_high,pairs",
            [
                "5,4,1,0.9,1.1,12\n5,4,0,-1,1,12",
                "50,4.1,1,0.9,1.1,12\n50,4,0,-1,1,11",
            ],
            "seconds_with 0 0 2, seconds_without 1 0 1, seconds_added 2 0 0, pairs 1 1 0",
        ),
        (
            "outputs.csv",
            "seconds,seconds_low,seconds_high,bytes",
            ["1,0.9,1.1,100", "1.2,1.1,1.3,101"],
            "seconds 1 0 0, bytes 0 1 0",
        ),
        // Names are the scene's.
        (
            "probes.csv",
            "t,seconds",
            ["0.5,1", "0.5,2"],
            "t 1 0 0, seconds 0 1 0",
        ),
        (
            "solids.csv",
            "iterations,seconds_median,seconds_min,seconds_max,ordering_seconds,ratio",
            ["12,1,0.8,1.2,0.1,3", "12,1,0.8,1.2,0.11,3.1"],
            "iterations 1 0 0, seconds_median 1 0 0, ordering_seconds 1 0 0, ratio 1 0 0",
        ),
        (
            "solve.csv",
            "rounds,cell_iterations_per_second,seconds_median,seconds_min,seconds_max,share_of_copy_bandwidth",
            ["2,10,1,0.8,1.2,0.1", "2,11,1,0.8,1.2,0.2"],
            "rounds 1 0 0, cell_iterations_per_second 1 0 0, seconds_median 1 0 0, share_of_copy_bandwidth 0 1 0",
        ),
        (
            "solve_against.csv",
            "device_seconds_median,device_seconds_min,device_seconds_max,ratio_median,ratio_min,ratio_max,note",
            [
                "1,0.8,1.2,3,2,4,\n1,0.8,1.2,,,,",
                "1.1,0.9,1.3,5,4,6,\n1.1,0.9,1.3,5,4,6,",
            ],
            "device_seconds_median 2 0 0, ratio_median 1 1 0",
        ),
        (
            "stability.csv",
            "energy_ratio,elastic_ratio,most_iterations,seconds",
            ["1.01,0.1,7,3\n1,0.1,7,3", "1.02,0.1,7,4\n1,0.2,8,"],
            "energy_ratio 1 1 0, elastic_ratio 1 1 0, most_iterations 1 1 0, seconds 0 1 1",
        ),
        (
            "stability_limit.csv",
            "ratio",
            ["0.5", "0.6"],
            "ratio 0 1 0",
        ),
        (
            "step.csv",
            // Those of different sub-steps are no spread of repeats.
            "iterations,seconds_median,seconds_min,seconds_max,\
             sub_step_seconds_median,sub_step_seconds_min,sub_step_seconds_max,cells_per_second",
            ["12,1,0.8,1.2,1,0.1,10,7", "12.5,1,0.8,1.2,1.1,0.1,16,14"],
            "iterations 0 1 0, seconds_median 1 0 0, sub_step_seconds_median 1 0 0, sub_step_seconds_min 1 0 0, \
             sub_step_seconds_max 0 1 0, cells_per_second 0 1 0",
        ),
        (
            "steps.csv",
            "dt,volume_ratio,seconds_total,seconds_advect_markers",
            ["0.1,1,3,1", "0.1,1.1,4,2"],
            "dt 1 0 0, volume_ratio 0 1 0, seconds_total 0 0 1, seconds_advect_markers 0 0 1",
        ),
        (
            "summary.csv",
            "time.frames_per_second,seconds,worst_residual",
            ["24,3,1e-9", "25,4,1e-9"],
            "time.frames_per_second 0 1 0, seconds 0 0 1, worst_residual 1 0 0",
        ),
        (
            "thesis.csv",
            "ratio_p,ratio_v,ratio_u,seconds_median,seconds_min,seconds_max",
            ["1,1,1,1,0.8,1.2", "1.1,1.2,1,1,0.8,1.2"],
            "ratio_p 0 1 0, ratio_v 0 1 0, ratio_u 1 0 0, seconds_median 1 0 0",
        ),
        // Rows of times, and of what repeats, whose ends are numbers as others.
        (
            "thesis_means.csv",
            "quantity,mean,low,high,least,largest,ratio",
            [
                "frame_seconds,1,0.8,1.2,0.9,1.1,0.5\nnonzeros,100,100,100,90,110,0.9",
                "frame_seconds,1.1,0.9,1.3,1.0,1.2,0.55\nnonzeros,101,101,101,90,111,0.91",
            ],
            "quantity 2 0 0, mean 1 1 0, low 0 1 0, high 0 1 0, least 2 0 0, largest 1 1 0, ratio 1 1 0",
        ),
        (
            "thesis_scenes.csv",
            "ratio_nodes,seconds_median,seconds_min,seconds_max,thesis_seconds_least,\
             projection_median,projection_min,projection_max,solve_median",
            [
                "1,1,0.8,1.2,0.5,0.5,0.4,0.6,0.3",
                "1.1,1,0.8,1.2,0.6,0.6,0.5,0.7,0.31",
            ],
            "ratio_nodes 0 1 0, seconds_median 1 0 0, thesis_seconds_least 0 1 0, \
             projection_median 1 0 0, solve_median 1 0 0",
        ),
        (
            "validation.csv",
            "got,verdict,seconds,share",
            ["0.5,pass,10.0,5e-1", "0.5,pass,12.0,6e-1"],
            "got 1 0 0, verdict 1 0 0, seconds 0 0 1, share 0 1 0",
        ),
    ];
    for (file, heads, rows, _) in &cases {
        for (dir, rows) in [&first, &second].into_iter().zip(rows) {
            fs::write(dir.join(file), format!("{heads}\n{rows}\n")).unwrap();
        }
    }
    let found = agreement(&first, &second).unwrap();
    for (file, _, _, said) in &cases {
        let columns = found.columns.iter().filter(|row| row.file == *file);
        let columns: Vec<String> = columns
            .map(|row| {
                let counts = [row.agree, row.differ, row.unjudged];
                assert_eq!(row.rows, counts.iter().sum::<usize>(), "{row:?}");
                let [agree, differ, unjudged] = counts;
                format!("{} {agree} {differ} {unjudged}", row.column)
            })
            .collect();
        assert_eq!(columns.join(", "), *said, "{file}");
    }
}

#[test]
fn tables_of_one_run_alone_are_no_agreement() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    for dir in [&first, &second] {
        fs::create_dir_all(dir.join("solve")).unwrap();
        fs::write(dir.join("solve/solve.csv"), "grid,iterations\n20,12\n").unwrap();
        // Of a comparison before.
        fs::write(dir.join("solve/agreement.csv"), "file\n").unwrap();
    }
    fs::remove_file(second.join("solve/agreement.csv")).unwrap();
    let found = agreement(&first, &second).unwrap();
    assert!(found.missing.is_empty(), "{found:?}");
    found.verdict().unwrap();
    let [against, steps] = ["solve/solve_against.csv", "steps.csv"];
    fs::write(first.join(against), "grid\n20\n").unwrap();
    fs::write(second.join(steps), "step\n0\n").unwrap();
    let found = agreement(&first, &second).unwrap();
    assert_eq!(found.missing, [second.join(against), first.join(steps)]);
    let verdict = found.verdict().unwrap_err();
    assert_eq!(verdict.exit_code(), 1, "{verdict}");
    let told = "columns that differ: 0; tables that only one of the folders has: 2";
    assert!(verdict.to_string().contains(told), "{verdict}");
}

/// The bandwidth of a copy is measured once in each run, and shares go with it.
#[test]
fn shares_are_compared_times_the_bandwidth() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    let heads = "seconds_median,seconds_min,seconds_max,share_of_copy_bandwidth";
    let write = |dir: &Path, share: f64, bandwidth: f64| {
        fs::create_dir_all(dir).unwrap();
        let rows = format!("{heads}\n1,0.9,1.1,{share}\n");
        fs::write(dir.join("step_stages.csv"), rows).unwrap();
        let json = format!("{{\"copy_bandwidth\": {{\"median\": {bandwidth}}}}}");
        fs::write(dir.join("step.json"), json).unwrap();
    };
    let differ = || {
        let found = agreement(&first, &second).unwrap();
        let share = found.columns.last().unwrap();
        assert_eq!(share.column, "share_of_copy_bandwidth");
        share.differ
    };
    write(&first, 0.8, 5e9);
    write(&second, 0.42, 1e10);
    assert_eq!(differ(), 0);
    for bandwidth in [5e9, 2e10] {
        write(&second, 0.42, bandwidth);
        assert_eq!(differ(), 1, "{bandwidth}");
    }
}
