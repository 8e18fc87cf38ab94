//! A scene file as a tree of values with their origins, overlaid with `--set`, and typed queries of it.
//!
//! Every error names the file and line, or the `--set`, and the dotted key. The document records all queries: the JSON schema is
//! derived from them.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::{Bound, RangeBounds};
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde_json::Value;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::MeshFile;
use super::suggestions::{Suggestion, suggestion};
use super::without::{is_continued, override_option, remove};
use crate::error::Error;

/// Origin of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Origin {
    /// Line of the file, from 1.
    Line(usize),
    /// Index of the override.
    Set(usize),
}

#[derive(Debug)]
pub(super) struct Node {
    origin: Origin,
    pub(super) content: Content,
}

#[derive(Debug)]
pub(super) enum Content {
    Text(String),
    Integer(i64),
    Float(f64),
    Boolean(bool),
    Date,
    Array(Vec<Node>),
    Table(BTreeMap<String, Node>),
}

impl Content {
    fn describe(&self) -> String {
        match self {
            Content::Text(text) => format!("the text \"{text}\""),
            Content::Integer(value) => format!("the number {value}"),
            Content::Float(value) => format!("the number {value:?}"),
            Content::Boolean(value) => format!("{value}"),
            Content::Date => "a date".to_owned(),
            Content::Array(items) => format!("a list of {}", items.len()),
            Content::Table(_) => "a table".to_owned(),
        }
    }

    fn json(&self) -> Value {
        match self {
            Content::Text(text) => text.as_str().into(),
            &Content::Integer(value) => value.into(),
            &Content::Float(value) => value.into(),
            &Content::Boolean(value) => value.into(),
            Content::Date => self.describe().into(),
            Content::Array(items) => items.iter().map(|item| item.content.json()).collect(),
            Content::Table(entries) => entries.iter().map(|(name, node)| (name.clone(), node.content.json())).collect(),
        }
    }

    /// The value as TOML, the same for equal values.
    pub(super) fn written(&self) -> String {
        let list = |items: &mut dyn Iterator<Item = String>| items.collect::<Vec<_>>().join(", ");
        match self {
            Content::Text(text) => format!("{text:?}"),
            Content::Integer(value) if value.unsigned_abs() < 1 << 53 => short(*value as f64),
            Content::Integer(value) => value.to_string(),
            Content::Float(value) => short(*value),
            Content::Boolean(value) => value.to_string(),
            Content::Date => self.describe(),
            Content::Array(items) => {
                format!("[{}]", list(&mut items.iter().map(|item| item.content.written())))
            }
            Content::Table(entries) => {
                let entries = entries.iter();
                let mut entries = entries.map(|(name, node)| format!("{name} = {}", node.content.written()));
                format!("{{ {} }}", list(&mut entries))
            }
        }
    }
}

impl Node {
    /// Adds the origins of the node and of its descendants.
    fn collect_origins(&self, key: &str, origins: &mut BTreeMap<String, Origin>) {
        origins.insert(key.to_owned(), self.origin);
        match &self.content {
            Content::Array(items) => {
                for (i, item) in items.iter().enumerate() {
                    item.collect_origins(&format!("{key}[{i}]"), origins);
                }
            }
            Content::Table(entries) => {
                for (name, node) in entries {
                    node.collect_origins(&join(key, name), origins);
                }
            }
            _ => {}
        }
    }
}

impl Node {
    /// The entry of a table or list one step below this node, which has the key `key`, and the steps after it. Creates a missing table.
    ///
    /// # Errors
    /// Problem and cure.
    fn entry<'s>(
        &mut self,
        key: &mut String,
        (step, rest): (&Step, &'s [Step]),
        origin: Origin,
    ) -> Result<(&mut Node, &'s [Step]), [String; 2]> {
        let described = self.content.describe();
        match (step.clone(), &mut self.content) {
            (Step::Key(name), Content::Table(entries)) => {
                *key = join(key, &name);
                let table = || Node { origin, content: Content::Table(BTreeMap::new()) };
                Ok((entries.entry(name).or_insert_with(table), rest))
            }
            (Step::Key(name), Content::Array(items)) => {
                let problem = format!("`{key}` is a list of {}", items.len());
                let names: Vec<&str> = items.iter().filter_map(Node::label).collect();
                let cure = match names.is_empty() {
                    true => format!("select an entry: {key}[0].{name}"),
                    false => {
                        format!("select an entry by its number, such as {key}[0], or by its name: {}", names.join(", "))
                    }
                };
                // The longest name, since names may have points.
                let mut found = None;
                let mut label = name;
                for used in 0..=rest.len() {
                    let at = items.iter().position(|item| item.label() == Some(&*label));
                    found = at.map(|i| (i, used)).or(found);
                    match rest.get(used) {
                        Some(Step::Key(more)) => label = format!("{label}.{more}"),
                        _ => break,
                    }
                }
                let (i, used) = found.ok_or([problem, cure])?;
                *key = format!("{key}[{i}]");
                Ok((&mut items[i], &rest[used..]))
            }
            (Step::Index(i), Content::Array(items)) => {
                let n = items.len();
                *key = format!("{key}[{i}]");
                let cure = match n {
                    0 => "add the entry to the scene file".to_owned(),
                    _ => format!("use an index from 0 to {}", n - 1),
                };
                let problem = format!("there is no `{key}`: the list has {n} entries");
                let item = items.get_mut(i).ok_or([problem, cure])?;
                Ok((item, rest))
            }
            (Step::Index(_), Content::Table(entries)) if entries.is_empty() => Err([
                format!("there is no list `{key}`"),
                "add the entry to the scene file, or set the whole list".to_owned(),
            ]),
            (Step::Index(i), _) => Err([format!("`{key}` is {described}, not a list"), format!("remove the [{i}]")]),
            (Step::Key(name), _) => {
                Err([format!("`{key}` is {described} and has no key `{name}`"), format!("set `{key}`")])
            }
        }
    }
}

/// Origins of the values of a scene file by dotted key, for errors that appear after the file was read.
#[derive(Clone, Debug, Default)]
pub struct Origins(BTreeMap<String, Origin>);

impl Origins {
    /// Origin of a value; for an absent key that of its table.
    pub(super) fn get(&self, key: &str) -> Option<Origin> {
        let ends = key.rmatch_indices(['.', '[']).map(|(end, _)| end);
        let mut keys = std::iter::once(key.len()).chain(ends).chain([0]);
        keys.find_map(|end| self.0.get(&key[..end]).copied())
    }
}

/// One query of a value: its required type and range. Strings are descriptions with the unit.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Query {
    Number(String),
    Positive,
    /// Ends of the range, and whether it includes them.
    Within([f64; 2], [bool; 2]),
    /// Length of the list.
    Numbers(usize, String),
    NumberOrVector(String),
    /// Least and largest value.
    Count(u64, u64, String),
    /// Length of the list, least and largest value.
    Counts(usize, u64, u64, String),
    Boolean,
    Text(String),
    /// Allowed words.
    Choice(Vec<String>),
    /// Allowed keys.
    Table(Vec<String>),
    List,
    /// A required key of the table.
    Required(String),
    /// Keys of which the table has exactly one.
    OneOf(Vec<String>),
}

/// A parsed scene file with its overrides.
#[derive(Debug)]
pub(super) struct Document {
    file: PathBuf,
    overrides: Vec<String>,
    root: Node,
    /// Keys that were removed because they refer to a removed part.
    removed: Vec<String>,
    /// Whether this is an example of the format, whose mesh files do not exist.
    exemplar: bool,
    /// Keys and their queries, in order.
    queries: RefCell<Vec<(String, Query)>>,
    mesh_files: RefCell<BTreeMap<PathBuf, MeshFile>>,
}

impl Document {
    /// Parses the text of `file` and applies the overrides in order. Successive removals have the indices before the first of them.
    pub(super) fn parse(file: &Path, text: &str, overrides: &[String]) -> Result<Document, Error> {
        let line_of =
            |offset: usize| 1 + text.as_bytes()[..offset.min(text.len())].iter().filter(|&&b| b == b'\n').count();
        let root = DeTable::parse(text).map_err(|error| Error::Scene {
            file: file.to_owned(),
            line: error.span().map_or(1, |span| line_of(span.start)),
            key: "TOML".to_owned(),
            problem: one_line(error.message()),
            cure: match error.message() {
                "duplicate key" => "keep one of them; entries of a list begin with double brackets, such as [[probe]]",
                _ => "correct the TOML syntax of this line",
            }
            .to_owned(),
        })?;
        let last_line = text.lines().count().max(1);
        let mut document = Document {
            file: file.to_owned(),
            overrides: overrides.to_vec(),
            root: Node { origin: Origin::Line(last_line), content: Content::Table(BTreeMap::new()) },
            removed: Vec::new(),
            exemplar: false,
            queries: RefCell::default(),
            mesh_files: RefCell::default(),
        };
        document.root.content = document.table(root.into_inner(), "", &|span| Origin::Line(line_of(span)))?;
        let removes = |setting: &String| override_option(setting)[0] == "--without";
        let mut first = 0;
        for block in overrides.chunk_by(|before, setting| is_continued(before, setting)) {
            match removes(&block[0]) {
                true => document.remove(block)?,
                false => (first..first + block.len()).try_for_each(|index| document.apply_override(index))?,
            }
            first += block.len();
        }
        Ok(document)
    }

    /// Removes the keys of successive overrides.
    fn remove(&mut self, overrides: &[String]) -> Result<(), Error> {
        let keys: Vec<&str> = overrides.iter().map(|setting| override_option(setting)[1]).collect();
        let removed = remove(&mut self.root, &keys);
        let refused =
            |(number, [problem, cure]): (usize, [String; 2])| Error::input(option(&overrides[number]), problem, cure);
        self.removed.extend(removed.map_err(refused)?);
        Ok(())
    }

    /// Parts that were removed because they refer to one that `--without` removed, by key or name.
    pub(super) fn removed(&self) -> &[String] {
        &self.removed
    }

    /// The scene as JSON.
    pub(super) fn json(&self) -> Value {
        self.root.content.json()
    }

    /// All values by key, as TOML.
    pub(super) fn values(&self) -> BTreeMap<String, String> {
        let mut values = BTreeMap::new();
        self.root.collect_values("", &mut values);
        values
    }

    pub(super) fn exemplar(text: &str) -> Result<Document, Error> {
        Ok(Document { exemplar: true, ..Document::parse(Path::new("exemplar.toml"), text, &[])? })
    }

    pub(super) fn is_exemplar(&self) -> bool {
        self.exemplar
    }

    pub(super) fn origins(&self) -> Origins {
        let mut origins = BTreeMap::new();
        self.root.collect_origins("", &mut origins);
        Origins(origins)
    }

    /// All queries, by key with indices.
    pub(super) fn into_queries(self) -> Vec<(String, Query)> {
        self.queries.into_inner()
    }

    pub(super) fn root(&self) -> Place<'_> {
        Place { document: self, key: String::new(), node: &self.root }
    }

    fn table(&self, table: DeTable<'_>, key: &str, origin: &dyn Fn(usize) -> Origin) -> Result<Content, Error> {
        let mut entries = BTreeMap::new();
        for (name, value) in table {
            let name = name.into_inner().into_owned();
            let node = self.node(value, &join(key, &name), origin)?;
            entries.insert(name, node);
        }
        Ok(Content::Table(entries))
    }

    fn node(&self, value: Spanned<DeValue<'_>>, key: &str, origin: &dyn Fn(usize) -> Origin) -> Result<Node, Error> {
        let place = origin(value.span().start);
        let content = match value.into_inner() {
            DeValue::String(text) => Content::Text(text.into_owned()),
            DeValue::Integer(number) => match i64::from_str_radix(number.as_str(), number.radix()) {
                Ok(number) => Content::Integer(number),
                Err(_) => {
                    let problem = format!("{number} lies beyond +-2^63");
                    return Err(self.fail(place, key, problem, "write a smaller number"));
                }
            },
            DeValue::Float(number) => match number.as_str().parse() {
                Ok(number) => Content::Float(number),
                Err(_) => {
                    return Err(self.fail(place, key, format!("{number} is not a number"), "write a number"));
                }
            },
            DeValue::Boolean(value) => Content::Boolean(value),
            DeValue::Datetime(_) => Content::Date,
            DeValue::Array(items) => {
                let items = items.into_iter().enumerate();
                Content::Array(
                    items.map(|(i, item)| self.node(item, &format!("{key}[{i}]"), origin)).collect::<Result<_, _>>()?,
                )
            }
            DeValue::Table(table) => self.table(table, key, origin)?,
        };
        Ok(Node { origin: place, content })
    }

    /// Stores the value of one `--set KEY=VALUE` in the tree; creates missing tables.
    fn apply_override(&mut self, index: usize) -> Result<(), Error> {
        let origin = Origin::Set(index);
        let setting = self.overrides[index].clone();
        let refuse =
            |problem: String, cure: String| Err(Error::Input { what: format!("--set {setting}"), problem, cure });
        let Some((path, text)) = setting.split_once('=') else {
            return refuse("has no `=`".into(), "write --set KEY=VALUE, such as --set liquid.density=800".into());
        };
        let Some(steps) = parse_path(path.trim()) else {
            let cure = "write dotted keys, with indices from 0 for lists, such as liquid.region[0].velocity";
            return refuse(format!("`{path}` is not a key"), cure.into());
        };
        let text = text.trim();
        let value = match DeValue::parse(text) {
            Ok(value) => self.node(value, path.trim(), &|_| origin)?,
            // Shells strip quotes, so a bare word is a text.
            Err(_) if !text.is_empty() && !text.contains(|c: char| c.is_whitespace() || "[]{}\"'=,#".contains(c)) => {
                Node { origin, content: Content::Text(text.to_owned()) }
            }
            Err(error) => {
                let cure = "write the value as in the scene file, in single quotes to keep it from the shell";
                return refuse(format!("`{text}` is not a TOML value: {}", one_line(error.message())), cure.into());
            }
        };
        let mut node = &mut self.root;
        let mut key = String::new();
        let mut steps = steps.as_slice();
        while let Some((step, rest)) = steps.split_first() {
            (node, steps) = match node.entry(&mut key, (step, rest), origin) {
                Ok(next) => next,
                Err([problem, cure]) => return refuse(problem, cure),
            };
        }
        *node = value;
        Ok(())
    }

    fn fail(&self, origin: Origin, key: &str, problem: impl Into<String>, cure: impl Into<String>) -> Error {
        let (problem, cure) = (problem.into(), cure.into());
        match origin {
            Origin::Line(line) => Error::Scene { file: self.file.clone(), line, key: key.to_owned(), problem, cure },
            Origin::Set(index) => {
                Error::Input { what: option(&self.overrides[index]), problem: format!("{key}: {problem}"), cure }
            }
        }
    }
}

/// An override as on the command line.
pub(super) fn option(setting: &str) -> String {
    override_option(setting).join(" ")
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Step {
    Key(String),
    Index(usize),
}

/// Steps of a path such as `liquid.region[0].box.min[1]`.
fn parse_path(path: &str) -> Option<Vec<Step>> {
    let mut steps = Vec::new();
    for part in path.split('.') {
        let (name, mut indices) = part.split_at(part.find('[').unwrap_or(part.len()));
        if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
            return None;
        }
        steps.push(Step::Key(name.to_owned()));
        while let Some(rest) = indices.strip_prefix('[') {
            let (index, rest) = rest.split_once(']')?;
            steps.push(Step::Index(index.parse().ok()?));
            indices = rest;
        }
        if !indices.is_empty() {
            return None;
        }
    }
    Some(steps)
}

/// Dotted key of an entry of a table.
pub(super) fn join(key: &str, name: &str) -> String {
    if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") }
}

/// A number without a row of zeros.
fn short(value: f64) -> String {
    match value != 0.0 && !(1e-4..1e7).contains(&value.abs()) {
        true => format!("{value:e}"),
        false => format!("{value}"),
    }
}

fn one_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join(", ")
}

pub(super) struct Keys {
    pub(super) valid: &'static [&'static str],
    /// Keys of other programs that do not exist here, with the reason.
    pub(super) absent: &'static [(&'static str, &'static str)],
}

impl Keys {
    pub(super) const fn new(valid: &'static [&'static str]) -> Keys {
        Keys { valid, absent: &[] }
    }
}

/// A value with its key and document.
#[derive(Clone, Debug)]
pub(super) struct Place<'a> {
    document: &'a Document,
    key: String,
    node: &'a Node,
}

impl<'a> Place<'a> {
    pub(super) fn fail(&self, problem: impl Into<String>, cure: impl Into<String>) -> Error {
        self.document.fail(self.node.origin, &self.key, problem, cure)
    }

    /// An error at this value unless `ok`.
    pub(super) fn ensure(&self, ok: bool, problem: impl Into<String>, cure: impl Into<String>) -> Result<(), Error> {
        if ok { Ok(()) } else { Err(self.fail(problem, cure)) }
    }

    pub(super) fn is_exemplar(&self) -> bool {
        self.document.exemplar
    }

    /// The mesh file with this path: one per scene, so that it is parsed once.
    pub(super) fn mesh_file(&self, path: PathBuf) -> MeshFile {
        let mut files = self.document.mesh_files.borrow_mut();
        let file = files.entry(path).or_insert_with_key(|path| path.clone().into());
        file.clone()
    }

    fn record(&self, query: Query) {
        let mut queries = self.document.queries.borrow_mut();
        queries.push((self.key.clone(), query));
    }

    /// An error unless the value, which [`Place::number`] or [`Place::positive`] returned, lies in a range.
    pub(super) fn within(
        &self,
        value: f64,
        range: impl RangeBounds<f64>,
        problem: impl Into<String>,
        cure: impl Into<String>,
    ) -> Result<(), Error> {
        let end = |bound: Bound<&f64>, open: f64| match bound {
            Bound::Included(&end) => (end, true),
            Bound::Excluded(&end) => (end, false),
            Bound::Unbounded => (open, false),
        };
        let (least, with_least) = end(range.start_bound(), f64::NEG_INFINITY);
        let (most, with_most) = end(range.end_bound(), f64::INFINITY);
        self.record(Query::Within([least, most], [with_least, with_most]));
        self.ensure(range.contains(&value), problem, cure)
    }

    pub(super) fn is_override(&self) -> bool {
        matches!(self.node.origin, Origin::Set(_))
    }

    pub(super) fn wrong_type(&self, expected: &str) -> Error {
        self.fail(format!("is {}", self.node.content.describe()), format!("write {expected}"))
    }

    /// A finite number. `what` is its name with the unit, such as `a density in kg/m^3`.
    pub(super) fn number(&self, what: &str) -> Result<f64, Error> {
        self.record(Query::Number(what.to_owned()));
        let value = match &self.node.content {
            Content::Integer(value) => *value as f64,
            Content::Float(value) => *value,
            Content::Text(text) if text.trim().parse::<f64>().is_ok() => {
                return Err(self.fail(format!("is the text \"{text}\""), format!("write {what} without quotes")));
            }
            _ => return Err(self.wrong_type(&format!("{what} as one number"))),
        };
        self.ensure(value.is_finite(), format!("is {value}"), format!("write {what} as a finite number"))?;
        Ok(value)
    }

    pub(super) fn positive(&self, what: &str) -> Result<f64, Error> {
        self.record(Query::Positive);
        let value = self.number(what)?;
        self.ensure(value > 0.0, format!("is {value}"), format!("write {what} above zero"))?;
        Ok(value)
    }

    /// A finite number in a range; `cure` names the range.
    pub(super) fn number_within(
        &self,
        what: &str,
        range: impl RangeBounds<f64>,
        cure: impl Into<String>,
    ) -> Result<f64, Error> {
        let value = self.number(what)?;
        self.within(value, range, format!("is {}", short(value)), cure)?;
        Ok(value)
    }

    /// A number above zero in a range; `cure` names the range.
    pub(super) fn positive_within(
        &self,
        what: &str,
        range: impl RangeBounds<f64>,
        cure: impl Into<String>,
    ) -> Result<f64, Error> {
        let value = self.positive(what)?;
        self.within(value, range, format!("is {}", short(value)), cure)?;
        Ok(value)
    }

    fn items<const N: usize>(&self, what: &str) -> Result<[Place<'a>; N], Error> {
        let Content::Array(items) = &self.node.content else {
            return Err(self.wrong_type(&format!("{what} as a list of {N} numbers")));
        };
        let places: Vec<_> = items.iter().enumerate().map(|(i, node)| self.item(i, node)).collect();
        let n = places.len();
        places
            .try_into()
            .map_err(|_| self.fail(format!("is a list of {n}"), format!("write {what} as a list of {N} numbers")))
    }

    fn item(&self, i: usize, node: &'a Node) -> Place<'a> {
        Place { document: self.document, key: format!("{}[{i}]", self.key), node }
    }

    pub(super) fn numbers<const N: usize>(&self, what: &str) -> Result<[f64; N], Error> {
        self.record(Query::Numbers(N, what.to_owned()));
        let mut values = [0.0; N];
        for (value, place) in values.iter_mut().zip(self.items::<N>(what)?) {
            *value = place.number(what)?;
        }
        Ok(values)
    }

    pub(super) fn vector(&self, what: &str) -> Result<DVec3, Error> {
        Ok(DVec3::from_array(self.numbers::<3>(what)?))
    }

    /// Three finite numbers, or one for all three.
    pub(super) fn number_or_vector(&self, what: &str) -> Result<DVec3, Error> {
        self.record(Query::NumberOrVector(what.to_owned()));
        match self.node.content {
            Content::Integer(_) | Content::Float(_) => self.number(what).map(DVec3::splat),
            _ => self.vector(what),
        }
    }

    /// A direction of any nonzero length, as a unit vector.
    pub(super) fn direction(&self, what: &str) -> Result<DVec3, Error> {
        let vector = self.vector(what)?;
        vector.try_normalize().ok_or_else(|| {
            let [x, y, z] = vector.to_array();
            self.fail(format!("is [{x}, {y}, {z}], which has no direction"), format!("write {what}, such as [0, 1, 0]"))
        })
    }

    /// A whole number from `min` to `max`.
    pub(super) fn count(&self, what: &str, min: u64, max: u64) -> Result<u64, Error> {
        self.record(Query::Count(min, max, what.to_owned()));
        let cure = format!("write {what} as a whole number from {min} to {max}");
        match &self.node.content {
            Content::Integer(value) => match u64::try_from(*value) {
                Ok(count) if (min..=max).contains(&count) => Ok(count),
                _ => Err(self.fail(format!("is {value}"), cure)),
            },
            other => Err(self.fail(format!("is {}", other.describe()), cure)),
        }
    }

    /// A list of `N` whole numbers from `min` to `max`.
    pub(super) fn counts<const N: usize>(&self, what: &str, min: u64, max: u64) -> Result<[usize; N], Error> {
        self.record(Query::Counts(N, min, max, what.to_owned()));
        let mut values = [0; N];
        for (value, place) in values.iter_mut().zip(self.items::<N>(what)?) {
            *value = place.count(what, min, max)? as usize;
        }
        Ok(values)
    }

    pub(super) fn boolean(&self) -> Result<bool, Error> {
        self.record(Query::Boolean);
        match self.node.content {
            Content::Boolean(value) => Ok(value),
            _ => Err(self.wrong_type("true or false, without quotes")),
        }
    }

    pub(super) fn text(&self, what: &str) -> Result<&'a str, Error> {
        self.record(Query::Text(what.to_owned()));
        match &self.node.content {
            Content::Text(text) if text.is_empty() => Err(self.fail("is empty", format!("write {what}"))),
            Content::Text(text) => Ok(text),
            _ => Err(self.wrong_type(&format!("{what} in quotes"))),
        }
    }

    /// One of some words of the format.
    pub(super) fn choice<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T, Error> {
        let words = choices.iter().map(|(word, _)| (*word).to_owned());
        self.record(Query::Choice(words.collect()));
        self.one_word(choices)
    }

    /// One of the names of this scene.
    pub(super) fn named<T: Copy>(&self, what: &str, names: &[(&str, T)]) -> Result<T, Error> {
        self.record(Query::Text(what.to_owned()));
        self.one_word(names)
    }

    fn one_word<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T, Error> {
        let words: Vec<_> = choices.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        let expected = format!("one of {}", words.join(", "));
        match &self.node.content {
            Content::Text(text) => match choices.iter().find(|(word, _)| word == text) {
                Some(&(_, value)) => Ok(value),
                None => Err(self.wrong_type(&expected)),
            },
            _ => Err(self.wrong_type(&expected)),
        }
    }

    /// A table without unknown keys.
    pub(super) fn table(self, keys: &Keys) -> Result<Table<'a>, Error> {
        let valid = keys.valid.iter().map(|&key| key.to_owned());
        self.record(Query::Table(valid.collect()));
        let Content::Table(entries) = &self.node.content else {
            return Err(match &self.node.content {
                Content::Array(_) => {
                    self.fail("is a list", format!("write one table: [{}] with single brackets", self.key))
                }
                Content::Text(name) if keys.valid.contains(&"file") => {
                    self.wrong_type(&format!("{{ file = {name:?} }}"))
                }
                _ => self.wrong_type(&format!("a table with the keys {}", keys.valid.join(", "))),
            });
        };
        let unknown = entries.iter().filter(|(name, _)| !keys.valid.contains(&name.as_str()));
        let first = unknown.min_by_key(|(_, node)| match node.origin {
            Origin::Line(line) => (0, line),
            Origin::Set(index) => (1, index),
        });
        if let Some((name, node)) = first {
            let place = Place { document: self.document, key: join(&self.key, name), node };
            return Err(place.unknown_key(name, keys));
        }
        Ok(Table { place: self, entries })
    }

    fn unknown_key(&self, name: &str, keys: &Keys) -> Error {
        let absent = keys.absent.iter().find(|(absent, _)| *absent == name);
        let nearest = keys
            .valid
            .iter()
            .map(|valid| (strsim::damerau_levenshtein(name, valid), *valid))
            .filter(|(distance, valid)| *distance <= (name.len().max(valid.len()) / 3).max(1))
            .min();
        let list = format!("the keys here are {}", keys.valid.join(", "));
        let suggestion = match absent {
            Some((_, reason)) => Some(Suggestion::Absent(reason)),
            None => suggestion(name, keys.valid),
        };
        let cure = match (suggestion, nearest) {
            (Some(Suggestion::Absent(reason)), nearest) if absent.is_some() || nearest.is_none() => {
                return self.fail(format!("is no key: {reason}"), format!("remove `{name}`"));
            }
            (Some(Suggestion::Write(instead)), _) => format!("write {instead}; {list}"),
            (Some(Suggestion::Key(valid)), _) | (_, Some((_, valid))) => {
                format!("did you mean `{valid}`? {list}")
            }
            (_, None) => list,
        };
        self.fail("unknown key", cure)
    }

    /// The entries of a list of tables.
    pub(super) fn list(&self) -> Result<Vec<Place<'a>>, Error> {
        self.record(Query::List);
        match &self.node.content {
            Content::Array(items) => Ok(items.iter().enumerate().map(|(i, node)| self.item(i, node)).collect()),
            Content::Table(_) => {
                Err(self.fail("is one table, not a list", format!("write [[{}]] with double brackets", self.key)))
            }
            _ => Err(self.wrong_type(&format!("a list: [[{}]] before each entry", self.key))),
        }
    }
}

/// A table without unknown keys.
#[derive(Clone, Debug)]
pub(super) struct Table<'a> {
    place: Place<'a>,
    entries: &'a BTreeMap<String, Node>,
}

impl<'a> Table<'a> {
    pub(super) fn get(&self, name: &str) -> Option<Place<'a>> {
        let node = self.entries.get(name)?;
        Some(Place { document: self.place.document, key: join(&self.place.key, name), node })
    }

    /// The value that `read` returns for a key, or `default` for an absent key.
    pub(super) fn optional<T>(
        &self,
        name: &str,
        default: T,
        read: impl FnOnce(Place<'a>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        self.get(name).map_or(Ok(default), read)
    }

    /// The value of a required key. `example` is a correct line.
    pub(super) fn required(&self, name: &str, example: &str) -> Result<Place<'a>, Error> {
        self.place.record(Query::Required(name.to_owned()));
        self.get(name).ok_or_else(|| {
            let key = join(&self.place.key, name);
            self.place.document.fail(self.place.node.origin, &key, "is missing", format!("write {example}"))
        })
    }

    /// The present one of several alternative keys, with its value.
    pub(super) fn one_of<'k>(&self, names: &[&'k str], what: &str) -> Result<(&'k str, Place<'a>), Error> {
        let all = names.iter().map(|&name| name.to_owned());
        self.place.record(Query::OneOf(all.collect()));
        let mut present = names.iter().filter_map(|&name| Some((name, self.get(name)?)));
        match (present.next(), present.next()) {
            (Some(one), None) => Ok(one),
            (None, _) => Err(self.fail(format!("has no {what}"), format!("add one of {}", names.join(", ")))),
            (Some((first, _)), Some((second, _))) => {
                Err(self.fail(format!("has `{first}` and `{second}`"), format!("keep one {what}")))
            }
        }
    }

    pub(super) fn fail(&self, problem: impl Into<String>, cure: impl Into<String>) -> Error {
        self.place.fail(problem, cure)
    }
}
