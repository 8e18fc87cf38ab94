//! `report --into`: tables of CSV files in Markdown documents, so that no number there is typed by hand.
//!
//! A document says what it wants between a head and an end, both comments in Markdown, and the lines between them are written anew:
//!
//! ```text
//! <!-- table
//! {"file": "solve/solve.csv", "where": {"precision": "mixed"},
//!  "columns": [["grid", "{grid}"], ["seconds (least, largest)", "{seconds_median} ({seconds_min}, {seconds_max})"]]}
//! -->
//! <!-- end of table -->
//! ```

use std::fs;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use crate::Error;
use crate::output::write_atomically;

use super::report::{EMPTY, records};

const HEAD: &str = "<!-- table";
const CLOSE: &str = "-->";
const END: &str = "<!-- end of table -->";
/// What stands in place of a table without rows.
const NONE: &str = "*None.*\n";

/// What a document wants of a table.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    /// Below the folder of the results.
    file: String,
    /// Rows: columns with what they must say.
    #[serde(default, rename = "where")]
    only: serde_json::Map<String, Value>,
    /// Heads, and what stands below: text with names of columns in braces.
    columns: Vec<[String; 2]>,
}

/// A table of a CSV file.
struct Found {
    heads: csv::StringRecord,
    rows: Vec<csv::StringRecord>,
    /// When, the adapter where there was one, and the CPU.
    measured: Option<String>,
}

/// What became of a document's tables.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Inserted {
    /// Tables that are written anew.
    pub written: usize,
    /// CSV files of those of them that have no row that is wanted: they say so.
    pub empty: Vec<String>,
    /// CSV files of those that are left as they are, since they are not below the folder.
    pub left: Vec<String>,
}

/// Writes the tables of documents anew from the results below `dir`, and says what became of each document's. Those of benches that did not run are
/// left as they are.
///
/// # Errors
/// [`Error::Input`] where a document or a file that it names cannot be read or has no head, it asks for columns that are not there or for no table,
/// or none of the files that all of them ask for is there; [`Error::Output`].
pub fn insert(dir: &Path, documents: &[impl AsRef<Path>]) -> Result<Vec<Inserted>, Error> {
    let anew = documents.iter();
    let anew = anew.map(|document| with_tables(dir, document.as_ref()));
    let anew: Vec<(Inserted, String)> = anew.collect::<Result<_, _>>()?;
    if anew.iter().any(|(tables, _)| tables.written > 0) {
        // All can be read and have what they ask for.
        for (document, (tables, text)) in documents.iter().zip(&anew) {
            if tables.written > 0 {
                write_atomically(document.as_ref(), text.as_bytes())?;
            }
        }
        return Ok(anew.into_iter().map(|(tables, _)| tables).collect());
    }
    let names = documents.iter();
    let names = names.map(|document| document.as_ref().display().to_string());
    let names: Vec<String> = names.collect();
    Err(Error::input(
        dir.display().to_string(),
        format!("no table is there that {} asks for", names.join(" or ")),
        "give the folder with the --out folders of the benches in it",
    ))
}

/// What became of a document's tables, and its text with them.
fn with_tables(dir: &Path, document: &Path) -> Result<(Inserted, String), Error> {
    let text = fs::read_to_string(document).map_err(|problem| {
        let cure = "give a Markdown file with <!-- table .. --> comments";
        Error::input(document.display().to_string(), problem.to_string(), cure)
    })?;
    let refused = |line: usize, problem: String, cure: &str| {
        Error::input(format!("{}:{line}", document.display()), problem, cure)
    };
    let mut out = String::new();
    let mut tables = Inserted::default();
    let mut lines = text.lines().enumerate();
    while let Some((at, line)) = lines.next() {
        out.push_str(line);
        out.push('\n');
        if line.trim() != HEAD {
            continue;
        }
        let head = at + 1;
        let mut wanted = String::new();
        loop {
            let Some((_, line)) = lines.next() else {
                let cure = "end what the table is of with a line -->";
                return Err(refused(head, "the comment does not end".to_owned(), cure));
            };
            out.push_str(line);
            out.push('\n');
            if line.trim() == CLOSE {
                break;
            }
            wanted.push_str(line);
            wanted.push('\n');
        }
        let mut old = String::new();
        let ends = lines.by_ref().any(|(_, line)| {
            let end = line.trim() == END;
            if !end {
                old.push_str(line);
                old.push('\n');
            }
            end
        });
        if !ends {
            let cure = "put a line <!-- end of table --> below it";
            return Err(refused(head, "the table does not end".to_owned(), cure));
        }
        let cure = "give JSON with file, columns and, if not all rows are wanted, where";
        let wanted: Wanted = serde_json::from_str(&wanted)
            .map_err(|problem| refused(head, problem.to_string(), cure))?;
        let file = dir.join(&wanted.file);
        if file.exists() {
            let found = Found::read(&file)?;
            let cure = "name columns of the CSV file; in texts, within braces";
            let refused = |problem| refused(head, problem, cure);
            let rows = found.rows(&wanted).map_err(refused)?;
            out.push_str(&found.markdown(&wanted, &rows).map_err(refused)?);
            tables.written += 1;
            if rows.is_empty() {
                tables.empty.push(wanted.file);
            }
        } else {
            out.push_str(&old);
            tables.left.push(wanted.file);
        }
        out.push_str(END);
        out.push('\n');
    }
    if tables == Inserted::default() {
        let cure = "add <!-- table .. --> comments as docs/report.md shows";
        return Err(refused(1, "it asks for no table".to_owned(), cure));
    }
    Ok((tables, out))
}

impl Found {
    fn read(path: &Path) -> Result<Found, Error> {
        let (heads, rows) = records(path)?;
        if heads.is_empty() {
            return Err(Error::input(
                path.display().to_string(),
                EMPTY,
                "run the bench that writes it with options that give it rows, or remove it: then the table is left as it is",
            ));
        }
        Ok(Found {
            heads,
            rows,
            measured: measured(path),
        })
    }

    /// Where a column is, or that it is not there.
    fn column(&self, wanted: &Wanted, name: &str) -> Result<usize, String> {
        let at = self.heads.iter().position(|head| head == name);
        at.ok_or_else(|| format!("{} has no column {name:?}", wanted.file))
    }

    /// The rows that are wanted; or the name of a column that is not there.
    fn rows(&self, wanted: &Wanted) -> Result<Vec<&csv::StringRecord>, String> {
        let conditions = wanted.only.iter();
        let conditions = conditions.map(|(name, value)| {
            let text = match value {
                Value::String(text) => text.clone(),
                other => other.to_string(),
            };
            Ok((self.column(wanted, name)?, text))
        });
        let conditions: Vec<(usize, String)> = conditions.collect::<Result<_, String>>()?;
        let says = |cell: &str, text: &str| {
            let numbers = cell.parse::<f64>().ok().zip(text.parse::<f64>().ok());
            cell == text || numbers.is_some_and(|(a, b)| a == b)
        };
        let rows = self.rows.iter().filter(|row| {
            let mut conditions = conditions.iter();
            conditions.all(|(at, text)| says(&row[*at], text))
        });
        Ok(rows.collect())
    }

    /// Rows in the columns that are wanted, and where they were measured; or what is wrong with a column, also where there are no rows.
    fn markdown(&self, wanted: &Wanted, rows: &[&csv::StringRecord]) -> Result<String, String> {
        let column = |name: &str| self.column(wanted, name);
        let templates = wanted.columns.iter();
        let templates = templates.map(|[_, text]| Template::read(text, column));
        let templates: Vec<Template> = templates.collect::<Result<_, String>>()?;
        let mut out = String::new();
        if rows.is_empty() {
            out.push_str(NONE);
        } else {
            let heads = wanted.columns.iter().map(|[head, _]| head.as_str());
            let heads: Vec<&str> = heads.collect();
            out.push_str(&format!("| {} |\n", heads.join(" | ")));
            out.push_str(&format!("|{}\n", "---|".repeat(heads.len())));
        }
        for row in rows {
            let cells = templates.iter().map(|template| template.fill(row));
            let cells: Vec<String> = cells.collect();
            out.push_str(&format!("| {} |\n", cells.join(" | ")));
        }
        if let Some(measured) = &self.measured {
            out.push_str(&format!("\n*{measured}*\n"));
        }
        Ok(out)
    }
}

/// What stands in a column: texts, each with the column of the CSV file after it, and the text at the end.
struct Template<'a> {
    cells: Vec<(&'a str, usize)>,
    end: &'a str,
}

impl<'a> Template<'a> {
    /// `column` tells where the column of a name is.
    fn read(
        text: &'a str,
        column: impl Fn(&str) -> Result<usize, String>,
    ) -> Result<Template<'a>, String> {
        let mut cells = Vec::new();
        let mut rest = text;
        while let Some((before, inner)) = rest.split_once('{') {
            let unclosed = || format!("a brace in {text:?} does not close");
            let (name, after) = inner.split_once('}').ok_or_else(unclosed)?;
            cells.push((before, column(name)?));
            rest = after;
        }
        Ok(Template { cells, end: rest })
    }

    /// With the cells of a row. Where all of them are empty, so is what it gives.
    fn fill(&self, row: &csv::StringRecord) -> String {
        let mut out = String::new();
        if self.cells.iter().all(|&(_, at)| row[at].is_empty()) {
            return out;
        }
        for &(before, at) in &self.cells {
            out.push_str(before);
            out.push_str(&rounded(&row[at]));
        }
        out.push_str(self.end);
        out
    }
}

/// A number with three digits, as far as it is not whole, without zeros at the end before a power of ten; other text as it is.
fn rounded(cell: &str) -> String {
    let whole = cell.parse::<i64>().is_ok();
    match cell.parse::<f64>() {
        Ok(number) if !whole && number.is_finite() => {
            // The power of what it is rounded to: 0.9996 is 1.00.
            let text = format!("{number:.2e}");
            let (digits, power) = text.split_once('e').expect("it is written with a power");
            let power: i32 = power.parse().expect("it is a power of ten");
            if number == 0.0 {
                "0".to_owned()
            } else if (-3..4).contains(&power) {
                let decimals = (2 - power).max(0) as usize;
                format!("{number:.decimals$}")
            } else {
                let digits = digits.trim_end_matches('0').trim_end_matches('.');
                format!("{digits}e{power}")
            }
        }
        _ => cell.replace('|', "\\|"),
    }
}

/// The JSON file of a table's bench, beside it.
pub(super) fn beside(path: &Path) -> Option<Value> {
    let stem = path.file_stem()?.to_str()?;
    let parts: Vec<&str> = stem.split('_').collect();
    // Tables of a bench are called as its JSON file is, and more.
    let names = (1..=parts.len()).rev().map(|n| parts[..n].join("_"));
    let texts = names.map(|name| path.with_file_name(format!("{name}.json")));
    let text = texts
        .into_iter()
        .find_map(|path| fs::read_to_string(path).ok())?;
    serde_json::from_str(&text).ok()
}

/// Where and when the tables of a bench were measured, from the JSON file beside them.
fn measured(path: &Path) -> Option<String> {
    let json = beside(path)?;
    let say = |key: &str| Some(json.get(key)?.as_str()?.to_owned());
    let number = |key: &str| json.get(key)?.as_f64();
    // Where several runs measured the rows, first to last.
    let parts = json.get("parts").and_then(Value::as_array);
    let parts = parts.map_or(std::slice::from_ref(&json), Vec::as_slice);
    let date = |part: &Value| {
        let date = part.get("measured")?.as_str()?.split('T').next()?;
        Some(date.to_owned())
    };
    let dates = span(date(parts.first()?)?, date(parts.last()?)?);
    let range = |key: &str, text: fn(f64) -> String| {
        let values = parts.iter().filter_map(|part| part.pointer(key)?.as_f64());
        let least = values.clone().reduce(f64::min)?;
        Some(span(text(least), text(values.reduce(f64::max)?)))
    };
    let bandwidth = range("/copy_bandwidth/median", |bandwidth: f64| {
        format!("{:.1}", 1e-9 * bandwidth)
    });
    // Runs on the CPU have neither.
    let adapter = say("adapter").zip(bandwidth);
    let adapter = adapter.map_or(String::new(), |(name, bandwidth)| {
        format!(", {name}, copy bandwidth {bandwidth} GB/s")
    });
    let cpu = say("cpu").map_or(String::new(), |cpu| format!(" ({cpu})"));
    let load = range("/load", |load: f64| load.to_string());
    let load = load.map_or(String::new(), |load| format!(" at a load of {load}"));
    // Tables of programs that were built from the same sources belong together.
    let sources = say("sources").map_or(String::new(), |sources| format!(" ({sources})"));
    Some(format!(
        "{dates}, cutwater {}{sources}{adapter}, {} CPU threads{cpu}{load}.",
        say("cutwater")?,
        number("threads")?,
    ))
}

/// Both ends, or what they both are.
fn span(first: String, last: String) -> String {
    match first == last {
        true => first,
        false => format!("{first} to {last}"),
    }
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn numbers_have_three_digits() {
        for (cell, expected) in [
            ("0.000975", "9.75e-4"),
            ("-0.000012345", "-1.23e-5"),
            ("0.00097", "9.7e-4"),
            ("0.00000001", "1e-8"),
            ("157498.5", "1.57e5"),
            ("0.0042", "0.00420"),
            ("0.9994", "0.999"),
            ("0.9996", "1.00"),
            ("9.996", "10.0"),
            ("1234.5678", "1235"),
            ("0.0", "0"),
            ("157498", "157498"),
            ("a|b", "a\\|b"),
            ("", ""),
        ] {
            assert_eq!(rounded(cell), expected, "{cell}");
        }
    }
}
