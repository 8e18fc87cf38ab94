//! Tables of a bench: columns are declared once, rows are named values, and one writer produces CSV, JSON and the lines of the terminal.

use std::path::Path;

use serde::{Deserialize, Serialize, Serializer};
use serde_json::Map;

use super::statistics::Spread;
use crate::Error;
use crate::measure::{remove, write_csv};

/// One value of a row; null where nothing was measured or a number is not finite.
pub use serde_json::Value;

/// An object; three values of a row.
impl From<Spread> for Value {
    fn from(Spread { median, min, max }: Spread) -> Value {
        serde_json::json!({ "median": median, "min": min, "max": max })
    }
}

/// Four digits for the terminal.
fn short(value: &Value) -> String {
    match value {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.lines().next().unwrap_or_default().to_owned(),
        Value::Number(number) if number.is_f64() => match number.as_f64().unwrap_or_default() {
            0.0 => "0".to_owned(),
            x if (1e-3..1e5).contains(&x.abs()) => {
                let digits = (3 - x.abs().log10().floor() as i32).max(0);
                format!("{x:.*}", digits as usize)
            }
            x => format!("{x:.2e}"),
        },
        other => other.to_string(),
    }
}

/// Endings of the columns of a spread.
const ENDS: [&str; 3] = ["_median", "_min", "_max"];

/// Named values.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Row(Map<String, Value>);

impl Row {
    /// A row of these values.
    pub fn new<N: AsRef<str>>(values: impl IntoIterator<Item = (N, Value)>) -> Row {
        let mut row = Row::default();
        values.into_iter().for_each(|(name, value)| row.set(name.as_ref(), value));
        row
    }

    /// Sets a value. A spread is three: `X_median`, `X_min`, `X_max`. An empty text is no value, as in a CSV file.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) {
        match value.into() {
            Value::Object(spread) => spread.into_iter().for_each(|(end, x)| self.set(&format!("{name}_{end}"), x)),
            Value::String(text) if text.is_empty() => self.set(name, Value::Null),
            value => drop(self.0.insert(name.to_owned(), value)),
        }
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// Adds the values of another row.
    pub fn with(mut self, other: Row) -> Row {
        self.0.extend(other.0);
        self
    }

    /// These values alone.
    pub fn only(&self, names: &[&str]) -> Row {
        Row::new(names.iter().map(|name| (name, self.get(name))))
    }

    /// A value; null if absent.
    pub fn get(&self, name: &str) -> Value {
        self.0.get(name).cloned().unwrap_or_default()
    }

    /// A number; NaN if absent.
    pub fn number(&self, name: &str) -> f64 {
        self.get(name).as_f64().unwrap_or(f64::NAN)
    }

    /// A whole number; 0 if absent.
    pub fn count(&self, name: &str) -> usize {
        self.number(name) as usize
    }

    /// A text; empty if absent.
    pub fn text(&self, name: &str) -> &str {
        self.0.get(name).and_then(Value::as_str).unwrap_or_default()
    }

    /// Texts joined by spaces.
    pub fn join(&self, names: &[&str]) -> String {
        let texts = names.iter().map(|name| self.text(name)).filter(|text| !text.is_empty());
        texts.collect::<Vec<_>>().join(" ")
    }

    /// Whether all values of another row are the same here.
    pub fn contains(&self, other: &Row) -> bool {
        other.names().all(|name| self.get(name) == other.get(name))
    }

    /// Whether a flag is set.
    pub fn flag(&self, name: &str) -> bool {
        self.get(name) == true
    }

    /// A spread.
    pub fn spread(&self, name: &str) -> Option<Spread> {
        let [median, min, max] = ENDS.map(|end| self.get(&format!("{name}{end}")).as_f64());
        Some(Spread { median: median?, min: min?, max: max? })
    }

    /// Whether there is a value.
    pub fn has(&self, name: &str) -> bool {
        !self.get(name).is_null()
    }
}

/// A row of named values: `row! { grid: n, seconds }`, where a name alone is that of its variable.
macro_rules! row {
    (@ $name:ident $value:expr) => { $crate::measure::bench::table::Value::from($value) };
    (@ $name:ident) => { $crate::measure::bench::table::Value::from($name) };
    ($($name:ident $(: $value:expr)?),* $(,)?) => {
        $crate::measure::bench::table::Row::new([$((stringify!($name), $crate::measure::bench::table::row!(@ $name $($value)?))),*])
    };
}
pub(crate) use row;

/// A column of a table.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Name in files.
    pub name: &'static str,
    /// Unit; empty for numbers without one and for names.
    pub unit: &'static str,
    /// Whether the terminal shows it.
    pub shown: bool,
    /// Whether it is three columns: `X_median`, `X_min`, `X_max`.
    pub spread: bool,
}

/// Columns: kind, one or more names, unit, and the meaning for the reader of the source. Kinds: `-` in files only, `+` in the terminal too, `~` a spread.
macro_rules! columns {
    ($($(#[$doc:meta])* $list:ident { $($kind:tt $($name:ident),+ $unit:literal $about:literal;)* })*) => { $(
        $(#[$doc])*
        pub(crate) const $list: &[$crate::measure::bench::table::Column] = &[$($($crate::measure::bench::table::Column {
            name: stringify!($name),
            unit: $unit,
            shown: stringify!($kind).as_bytes()[0] != b'-',
            spread: stringify!($kind).as_bytes()[0] == b'~',
        },)+)*];
    )* };
}
pub(crate) use columns;

impl Column {
    /// Names in files.
    fn heads(&self) -> Vec<String> {
        let ends = if self.spread { &ENDS[..] } else { &[""] };
        ends.iter().map(|end| format!("{}{end}", self.name)).collect()
    }

    /// Name and unit for the terminal.
    fn heading(&self) -> String {
        match self.unit {
            "" => self.name.to_owned(),
            unit => format!("{}/{unit}", self.name),
        }
    }

    /// Padded to the width of the heading, which fits most values.
    fn padded(&self, text: &str) -> String {
        let least = if self.spread { 26 } else { 9 };
        format!("{text:width$}  ", width = self.heading().len().max(least))
    }
}

/// A table and its columns.
#[derive(Clone, Debug)]
pub struct Table {
    /// Stem of its CSV file.
    pub name: &'static str,
    /// Columns, in groups.
    pub columns: &'static [&'static [Column]],
    /// Columns that identify a row.
    pub key: &'static [&'static str],
    /// Rows.
    pub rows: Vec<Row>,
}

impl Table {
    /// A table without rows.
    pub fn new(name: &'static str, columns: &'static [&'static [Column]], key: &'static [&'static str]) -> Table {
        Table { name, columns, key, rows: Vec::new() }
    }

    /// Names of the columns of files.
    fn heads(&self) -> Vec<String> {
        self.columns.iter().copied().flatten().flat_map(Column::heads).collect()
    }

    /// Columns that the terminal shows.
    fn shown(&self) -> impl Iterator<Item = &'static Column> + use<> {
        self.columns.iter().copied().flatten().filter(|column| column.shown)
    }

    /// Appends a row, or replaces the one with the same key.
    ///
    /// # Panics
    /// If a value has no column.
    pub(super) fn put(&mut self, row: Row) {
        let heads = self.heads();
        let unknown = row.names().find(|name| row.has(name) && heads.iter().all(|head| head != name));
        assert!(unknown.is_none(), "{} has no column {unknown:?}", self.name);
        let key = row.only(self.key);
        match self.rows.iter_mut().find(|other| other.contains(&key)) {
            Some(same) if !self.key.is_empty() => *same = row,
            _ => self.rows.push(row),
        }
    }

    /// Whether a row has these values.
    pub(super) fn has(&self, key: &Row) -> bool {
        self.rows.iter().any(|row| row.contains(key))
    }

    /// Writes the rows below a head line; an empty table is no file.
    pub(super) fn write_csv(&self, path: &Path) -> Result<(), Error> {
        if self.rows.is_empty() {
            return remove(path);
        }
        let heads = self.heads();
        let names = heads.iter().map(|head| Value::from(head.as_str())).collect();
        let rows = self.rows.iter().map(|row| heads.iter().map(|head| row.get(head)).collect());
        write_csv(path, std::iter::once(names).chain(rows))
    }

    /// Names of the columns that the terminal shows.
    pub fn heading(&self) -> String {
        self.shown().map(|column| column.padded(&column.heading())).collect()
    }

    /// The values of a row that the terminal shows.
    pub fn line(&self, row: &Row) -> String {
        let cells = self.shown().map(|column| {
            let values: Vec<String> = column.heads().iter().map(|head| short(&row.get(head))).collect();
            column.padded(&match &values[..] {
                [median, min, max] if median != "-" => format!("{median} ({min}, {max})"),
                values => values[0].clone(),
            })
        });
        cells.collect::<String>().trim_end().to_owned()
    }
}

/// Rows as JSON objects, in the order of the columns.
impl Serialize for Table {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let heads = self.heads();
        to.collect_seq(self.rows.iter().map(|row| Object(&heads, row)))
    }
}

struct Object<'a>(&'a [String], &'a Row);

impl Serialize for Object<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_map(self.0.iter().map(|head| (head, self.1.get(head))))
    }
}
