//! Tables of a bench: columns are declared once, rows are named values, and one writer produces CSV, JSON and the lines of the terminal.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Serialize, Serializer};

use super::statistics::Spread;
use crate::Error;
use crate::measure::{remove, write_csv};
use crate::scene::{PatchPressure, Precision, Preconditioner};

/// One value of a row.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// Not measured, or absent.
    #[default]
    Empty,
    /// Yes or no.
    Flag(bool),
    /// A whole number.
    Count(i64),
    /// A number; an empty cell if it is not finite.
    Number(#[serde(serialize_with = "finite")] f64),
    /// A name.
    Text(String),
    /// Three columns: `X_median`, `X_min`, `X_max`.
    Spread(Spread),
}

macro_rules! values {
    ($($($from:ty),*: |$value:ident| $to:expr;)*) => { $($(
        impl From<$from> for Value {
            fn from($value: $from) -> Value {
                $to
            }
        }
    )*)* };
}
values! {
    bool: |flag| Value::Flag(flag);
    i64: |n| Value::Count(n);
    u32: |n| Value::Count(n.into());
    usize, u64: |n| Value::Count(n.try_into().expect("a count fits into 63 bits"));
    f64: |x| Value::Number(x);
    Spread: |spread| Value::Spread(spread);
    // An empty text is no value, as in a CSV file.
    String: |text| if text.is_empty() { Value::Empty } else { Value::Text(text) };
    &str: |text| text.to_owned().into();
    Precision, Preconditioner, PatchPressure: |kind| kind.name().into();
}

impl<T: Into<Value>> From<Option<T>> for Value {
    fn from(value: Option<T>) -> Value {
        value.map_or(Value::Empty, Into::into)
    }
}

fn finite<S: Serializer>(x: &f64, to: S) -> Result<S::Ok, S::Error> {
    x.is_finite().then_some(x).serialize(to)
}

impl Value {
    /// The value of a cell of a CSV file.
    fn parse(cell: &str) -> Value {
        let flag = || cell.parse().ok().map(Value::Flag);
        let count = || cell.parse().ok().map(Value::Count);
        let number = || cell.parse().ok().map(Value::Number);
        flag().or_else(count).or_else(number).unwrap_or_else(|| cell.into())
    }

    /// NaN for anything but a number.
    fn number(&self) -> f64 {
        match *self {
            Value::Number(x) => x,
            Value::Count(n) => n as f64,
            _ => f64::NAN,
        }
    }

    /// Four digits for the terminal.
    fn short(&self) -> String {
        let short = |x: f64| match x.abs() {
            0.0 => "0".to_owned(),
            size @ 1e-3..1e5 => {
                let digits = (3 - size.log10().floor() as i32).max(0);
                format!("{x:.*}", digits as usize)
            }
            _ => format!("{x:.2e}"),
        };
        match self {
            Value::Empty => "-".to_owned(),
            Value::Flag(flag) => flag.to_string(),
            Value::Count(n) => n.to_string(),
            Value::Number(x) => short(*x),
            Value::Text(text) => text.lines().next().unwrap_or_default().to_owned(),
            Value::Spread(Spread { median, min, max }) => {
                format!("{} ({}, {})", short(*median), short(*min), short(*max))
            }
        }
    }
}

/// Endings of the three columns of a spread.
const ENDS: [&str; 3] = ["_median", "_min", "_max"];

/// Named values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row(BTreeMap<&'static str, Value>);

impl Row {
    /// A row of these values.
    pub fn new(values: impl IntoIterator<Item = (&'static str, Value)>) -> Row {
        Row(values.into_iter().collect())
    }

    /// Sets a value.
    pub fn set(&mut self, name: &'static str, value: impl Into<Value>) {
        self.0.insert(name, value.into());
    }

    /// Names of the values.
    pub(super) fn names(&self) -> impl Iterator<Item = &'static str> {
        self.0.keys().copied()
    }

    /// Adds the values of another row.
    pub fn with(mut self, other: Row) -> Row {
        self.0.extend(other.0);
        self
    }

    /// These values alone.
    pub fn only(&self, names: &[&'static str]) -> Row {
        Row::new(names.iter().map(|name| (*name, self.get(name))))
    }

    /// Value of a column, also of one of a spread; empty if absent.
    pub fn get(&self, name: &str) -> Value {
        let end = |(at, end)| {
            let Spread { median, min, max } = self.spread(name.strip_suffix(end)?)?;
            Some([median, min, max][at])
        };
        let value = self.0.get(name).cloned();
        value.unwrap_or_else(|| ENDS.into_iter().enumerate().find_map(end).into())
    }

    /// A number; NaN if absent.
    pub fn number(&self, name: &str) -> f64 {
        self.get(name).number()
    }

    /// A whole number; 0 if absent.
    pub fn count(&self, name: &str) -> usize {
        self.number(name) as usize
    }

    /// A text; empty if absent.
    pub fn text(&self, name: &str) -> &str {
        match self.0.get(name) {
            Some(Value::Text(text)) => text,
            _ => "",
        }
    }

    /// Texts joined by spaces.
    pub fn join(&self, names: &[&str]) -> String {
        let texts = names.iter().map(|name| self.text(name)).filter(|text| !text.is_empty());
        texts.collect::<Vec<_>>().join(" ")
    }

    /// Whether all values of another row are the same here.
    pub fn contains(&self, other: &Row) -> bool {
        other.0.iter().all(|(name, value)| self.get(name) == *value)
    }

    /// Whether a flag is set.
    pub fn flag(&self, name: &str) -> bool {
        self.get(name) == Value::Flag(true)
    }

    /// A spread.
    pub fn spread(&self, name: &str) -> Option<Spread> {
        match self.0.get(name) {
            Some(Value::Spread(spread)) => Some(*spread),
            _ => None,
        }
    }

    /// Whether there is a value.
    pub fn has(&self, name: &str) -> bool {
        self.get(name) != Value::Empty
    }
}

/// A row of named values: `row! { grid: n, seconds: spread }`.
macro_rules! row {
    ($($name:ident: $value:expr),* $(,)?) => {
        $crate::measure::bench::table::Row::new([$((stringify!($name), $crate::measure::bench::table::Value::from($value))),*])
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
    /// Meaning.
    pub about: &'static str,
    /// Whether the terminal shows it.
    pub shown: bool,
    /// Whether it is three columns: `X_median`, `X_min`, `X_max`.
    pub spread: bool,
    /// Whether it contains names, which may look like numbers.
    pub names: bool,
}

/// Columns, one a line: name, kind, unit, meaning. Kinds: `-` in files only, `+` in the terminal too, `~` a spread, `=` any
/// name.
macro_rules! columns {
    ($($(#[$doc:meta])* $list:ident { $($name:ident $kind:tt $unit:literal $about:literal;)* })*) => { $(
        $(#[$doc])*
        pub(crate) const $list: &[$crate::measure::bench::table::Column] = &[$($crate::measure::bench::table::Column {
            name: stringify!($name),
            unit: $unit,
            about: $about,
            shown: stringify!($kind).as_bytes()[0] != b'-',
            spread: stringify!($kind).as_bytes()[0] == b'~',
            names: stringify!($kind).as_bytes()[0] == b'=',
        }),*];
    )* };
}
pub(crate) use columns;

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

    fn columns(&self) -> impl Iterator<Item = &'static Column> + use<> {
        self.columns.iter().copied().flatten()
    }

    /// Names of the columns of files.
    fn heads(&self) -> Vec<String> {
        let ends = |column: &Column| if column.spread { &ENDS[..] } else { &[""] };
        self.columns().flat_map(|column| ends(column).iter().map(|end| format!("{}{end}", column.name))).collect()
    }

    /// Appends a row, or replaces the one with the same key.
    ///
    /// # Panics
    /// If a value has no column.
    pub(super) fn put(&mut self, row: Row) {
        let unknown = row.names().find(|name| self.columns().all(|column| column.name != *name));
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

    /// Reads the rows of an earlier run; none without a file.
    pub(super) fn read_csv(&mut self, path: &Path) -> Result<(), Error> {
        if !path.exists() {
            return Ok(());
        }
        let row = |record: BTreeMap<String, String>| {
            let text = |name: &str| record.get(name).map_or("", String::as_str);
            let cell = |name: &str| Value::parse(text(name));
            Row::new(self.columns().map(|column| {
                let [median, min, max] = ENDS.map(|end| cell(&format!("{}{end}", column.name)).number());
                let value = match column.spread {
                    false if column.names => text(column.name).into(),
                    false => cell(column.name),
                    true if median.is_finite() => Value::Spread(Spread { median, min, max }),
                    true => Value::Empty,
                };
                (column.name, value)
            }))
        };
        let rows = csv::Reader::from_path(path)
            .and_then(|mut reader| reader.deserialize().map(|record| record.map(row)).collect());
        self.rows = rows.map_err(|problem| super::refused(path, format!("cannot be read: {problem}")))?;
        Ok(())
    }

    /// Names of the columns that the terminal shows.
    pub fn heading(&self) -> String {
        self.columns().filter(|column| column.shown).map(|column| padded(heading(column), column)).collect()
    }

    /// The values of a row that the terminal shows.
    pub fn line(&self, row: &Row) -> String {
        let shown = self.columns().filter(|column| column.shown);
        let cells = shown.map(|column| padded(row.0.get(column.name).unwrap_or(&Value::Empty).short(), column));
        cells.collect::<String>().trim_end().to_owned()
    }
}

fn heading(Column { name, unit, .. }: &Column) -> String {
    match *unit {
        "" => (*name).to_owned(),
        _ => format!("{name}/{unit}"),
    }
}

/// Padded to the width of the head of its column, which fits most values.
fn padded(text: String, column: &Column) -> String {
    let least = if column.spread { 26 } else { 9 };
    format!("{text:width$}  ", width = heading(column).len().max(least))
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
