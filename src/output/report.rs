//! `report`: results of benches and runs in the folders below one, as one HTML page that needs nothing else.
//!
//! A folder is a section: conditions of the measurement from manifest.json or the tables' JSON, then pictures, then tables. Tables are those
//! of the CSV files, number for number; nothing is computed here.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use roxmltree::{Document, ParsingOptions};

use crate::Error;
use crate::output::manifest::Manifest;
use crate::output::preview::ensure_whole_png;
use crate::output::write_atomically;

/// The page's name in the folder.
pub const PAGE: &str = "report.html";
/// Pictures of a run that are shown: its first, one in the middle, its last.
const PICTURES: usize = 3;
/// Rows of a table that are shown; those of a long run are in its file.
const MOST_ROWS: usize = 400;
/// Characters of a cell above which it is cut where it is shown; the pointer over it shows all.
const LONG: usize = 40;

const STYLE: &str = "
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1200px; padding: 0 1rem; color: #1b1f24 }
h2 { border-bottom: 1px solid #d0d7de; margin-top: 3rem } figure { margin: 1rem 0 } svg, img { max-width: 100%; height: auto }
.wide { overflow-x: auto } table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px }
th, td { border: 1px solid #d0d7de; padding: .15rem .5rem; text-align: right } th { background: #f6f8fa }
td:first-child, th:first-child { text-align: left } td { white-space: nowrap }
.long { max-width: 30ch; overflow: hidden; text-overflow: ellipsis; text-align: left }
dl { display: grid; grid-template-columns: max-content auto; gap: 0 1rem; font-size: 13px } dt { font-weight: 600 } dd { margin: 0; overflow-wrap: anywhere }
.pictures { display: flex; gap: .5rem; flex-wrap: wrap } .pictures img { width: 380px }
";

/// Files of a folder.
#[derive(Debug, Default)]
struct Folder {
    path: PathBuf,
    json: Vec<PathBuf>,
    svg: Vec<PathBuf>,
    csv: Vec<PathBuf>,
    pictures: Vec<PathBuf>,
}

/// Counts of a page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Folders with anything to show.
    pub folders: usize,
    /// Tables.
    pub tables: usize,
    /// Pictures, drawn or rendered.
    pub pictures: usize,
}

/// Writes `DIR/report.html`.
///
/// # Errors
/// [`Error::Input`] where the folder is not there or holds nothing to show, or a file that it would show is broken; [`Error::Output`].
pub fn report(dir: &Path) -> Result<Contents, Error> {
    let refused = |problem: String| {
        let cure = "give the --out folder of a run or a bench, or one that holds such folders";
        Err(Error::input(dir.display().to_string(), problem, cure))
    };
    if !dir.is_dir() {
        return refused("no such folder".to_owned());
    }
    let mut folders = Vec::new();
    gather(dir, &mut folders)?;
    if folders.is_empty() {
        return refused("it holds no table and no picture".to_owned());
    }
    let mut contents = Contents { folders: folders.len(), ..Contents::default() };
    let sections = folders.iter().map(|folder| {
        contents.tables += folder.csv.len();
        contents.pictures += folder.svg.len() + folder.pictures.len();
        section(dir, folder)
    });
    let sections: Vec<Markup> = sections.collect::<Result<_, _>>()?;
    let name = dir.canonicalize().ok().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
    let title = format!("cutwater: {}", name.unwrap_or_default());
    let names = folders.iter().map(|folder| label(dir, folder));
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                nav { ul { @for (at, name) in names.enumerate() { li { a href={ "#folder-" (at) } { (name) } } } } }
                @for (at, section) in sections.iter().enumerate() { section id={ "folder-" (at) } { (section) } }
            }
        }
    };
    write_atomically(&dir.join(PAGE), page.into_string().as_bytes())?;
    Ok(contents)
}

fn read(path: &Path) -> Result<String, Error> {
    fs::read_to_string(path).map_err(|problem| unreadable(path, &problem))
}

fn unreadable(path: &Path, problem: &dyn std::fmt::Display) -> Error {
    Error::input(
        path.display().to_string(),
        format!("cannot be read: {problem}"),
        "write it again, or move it elsewhere",
    )
}

/// The folders below one, itself first, in the order of their names; frames are left alone.
fn gather(dir: &Path, folders: &mut Vec<Folder>) -> Result<(), Error> {
    let entries = fs::read_dir(dir).map_err(|problem| unreadable(dir, &problem))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let mut folder = Folder { path: dir.to_owned(), ..Folder::default() };
    for path in paths.iter().filter(|path| path.is_file()) {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => folder.json.push(path.clone()),
            Some("svg") => folder.svg.push(path.clone()),
            Some("csv") => folder.csv.push(path.clone()),
            Some("png") => folder.pictures.push(path.clone()),
            _ => {}
        }
    }
    // A run's preview has a picture for each frame; before them sorts the animation, which browsers play.
    folder.pictures = some_of(folder.pictures);
    if !(folder.svg.is_empty() && folder.csv.is_empty() && folder.pictures.is_empty()) {
        folders.push(folder);
    }
    let inner = paths.iter().filter(|path| path.is_dir());
    for path in inner.filter(|path| path.file_name() != Some("frames".as_ref())) {
        gather(path, folders)?;
    }
    Ok(())
}

/// Message about a table without a head line.
pub(super) const EMPTY: &str = "it is empty: not even the names of its columns are there";

/// Heads and rows of a table; neither of an empty file.
fn records(path: &Path) -> Result<(csv::StringRecord, Vec<csv::StringRecord>), Error> {
    let text = read(path)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let heads = reader.headers().map_err(|problem| unreadable(path, &problem))?.clone();
    let rows = reader.records().collect::<Result<_, _>>();
    let rows = rows.map_err(|problem| unreadable(path, &problem))?;
    if ends_in_quotes(&text) {
        return Err(unreadable(path, &"the last quotation mark is not closed"));
    }
    Ok((heads, rows))
}

/// Whether a table ends within quotes, which the reader takes for closed there: then one more line break would be a part of its last cell.
fn ends_in_quotes(text: &str) -> bool {
    let last = |end: &str| {
        let rows = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_reader(text.as_bytes().chain(end.as_bytes()))
            .into_records();
        rows.last().and_then(Result::ok)
    };
    last("") != last("\n")
}

/// The first, one in the middle and the last.
fn some_of(paths: Vec<PathBuf>) -> Vec<PathBuf> {
    let n = paths.len();
    if n <= PICTURES {
        return paths;
    }
    [0, n / 2, n - 1].map(|at| paths[at].clone()).to_vec()
}

fn label(dir: &Path, folder: &Folder) -> String {
    let inner = folder.path.strip_prefix(dir).unwrap_or(&folder.path);
    match inner.as_os_str().is_empty() {
        true => "this folder".to_owned(),
        false => inner.display().to_string(),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or(String::new(), |name| name.to_string_lossy().into_owned())
}

fn section(dir: &Path, folder: &Folder) -> Result<Markup, Error> {
    let facts = folder.json.iter().map(|path| facts(path));
    let mut facts: Vec<Vec<(String, String)>> = facts.collect::<Result<_, _>>()?;
    // Tables of one bench tell the same of it.
    facts.dedup();
    let drawn = folder.svg.iter().map(|path| Ok((file_name(path), drawing(path)?)));
    let drawn: Vec<(String, String)> = drawn.collect::<Result<_, Error>>()?;
    let rendered = folder.pictures.iter().map(|path| {
        let bytes = fs::read(path).map_err(|problem| unreadable(path, &problem))?;
        ensure_whole_png(&bytes).map_err(|problem| unreadable(path, &problem))?;
        Ok((file_name(path), STANDARD.encode(bytes)))
    });
    let rendered: Vec<(String, String)> = rendered.collect::<Result<_, Error>>()?;
    let tables = folder.csv.iter().map(|path| table(path));
    let tables: Vec<Markup> = tables.collect::<Result<_, _>>()?;
    Ok(html! {
        h2 { (label(dir, folder)) }
        @for facts in facts.iter().filter(|facts| !facts.is_empty()) {
            dl { @for (key, value) in facts { dt { (key) } dd { (value) } } }
        }
        @if !rendered.is_empty() {
            div class="pictures" {
                @for (name, bytes) in &rendered {
                    figure { img src={ "data:image/png;base64," (bytes) } alt=(name); figcaption { (name) } }
                }
            }
        }
        @for (name, data) in &drawn { figure { img src=(data) alt=(name); figcaption { (name) } } }
        @for table in &tables { (table) }
    })
}

/// Conditions of a measurement: the plain values of a JSON file, and numbers and texts one level down.
fn facts(path: &Path) -> Result<Vec<(String, String)>, Error> {
    use serde_json::Value;
    let value: Value = serde_json::from_str(&read(path)?).map_err(|problem| unreadable(path, &problem))?;
    let plain = |value: &Value| match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(short(&number.to_string())),
        Value::Bool(flag) => Some(flag.to_string()),
        Value::Null | Value::Array(_) | Value::Object(_) => None,
    };
    let mut facts = Vec::new();
    for (key, value) in value.as_object().into_iter().flatten() {
        if let Some(text) = plain(value) {
            facts.push((key.clone(), text));
        } else if let Some(inner) = value.as_object() {
            let inner = inner.iter().filter_map(|(inner, value)| Some((inner, plain(value)?)));
            facts.extend(inner.map(|(inner, text)| (format!("{key}.{inner}"), text)));
        }
    }
    Ok(facts)
}

/// A drawing as a data URI: as an image it runs no scripts and loads no other files.
fn drawing(path: &Path) -> Result<String, Error> {
    let text = read(path)?;
    // Other programs begin theirs with a document type.
    let options = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
    let document = Document::parse_with_options(&text, options);
    let document = document.map_err(|problem| unreadable(path, &problem))?;
    match document.root_element().tag_name().name() {
        "svg" => Ok(format!("data:image/svg+xml;base64,{}", STANDARD.encode(text))),
        _ => Err(unreadable(path, &"its root is no svg element")),
    }
}

/// Whether a table is steps.csv of a run without sub-steps: the first of them tells the columns.
fn is_before_first_step(path: &Path) -> bool {
    let run = path.parent().filter(|_| path.ends_with("steps.csv"));
    let manifest = run.and_then(|run| Manifest::read(run).ok());
    manifest.is_some_and(|manifest| manifest.progress.steps == 0)
}

fn table(path: &Path) -> Result<Markup, Error> {
    let (head, rows) = records(path)?;
    if head.is_empty() && !is_before_first_step(path) {
        return Err(unreadable(path, &EMPTY));
    }
    let left_out = rows.len().saturating_sub(MOST_ROWS);
    Ok(html! {
        details open[rows.len() <= 40] {
            summary { (file_name(path)) ", " (rows.len()) " rows" }
            div class="wide" {
                table {
                    thead { tr { @for name in &head { th { (name) } } } }
                    tbody {
                        @for row in rows.iter().take(MOST_ROWS) {
                            tr {
                                @for cell in row {
                                    @if cell.chars().count() > LONG { td class="long" title=(cell) { (short(cell)) } }
                                    @else { td { (short(cell)) } }
                                }
                            }
                        }
                    }
                }
            }
            @if left_out > 0 { p { (left_out) " more rows are in the file." } }
        }
    })
}

/// A number with as many digits as a reader takes in; the file has them all.
fn short(cell: &str) -> String {
    let exact = cell.parse::<i64>().is_ok();
    match cell.parse::<f64>() {
        Ok(number) if !exact && number.is_finite() => {
            let size = number.abs();
            match size == 0.0 || (1e-3..1e6).contains(&size) {
                true => format!("{number:.5}").trim_end_matches('0').trim_end_matches('.').to_owned(),
                false => format!("{number:.3e}"),
            }
        }
        _ => cell.to_owned(),
    }
}
