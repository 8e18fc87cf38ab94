//! A scene file as a tree of values that know where they were written, with `--set` laid over it, and typed access to it.
//! Every refusal names the file and line, or the `--set`, and the dotted key. What the reader asks of the values can be listened to:
//! the JSON schema is made of that.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::{Bound, RangeBounds};
use std::path::{Path, PathBuf};

use glam::DVec3;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::suggestions::{Suggestion, suggestion};
use crate::error::Error;

/// Where a value was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Origin {
    /// On this line of the file, from 1.
    Line(usize),
    /// By the override with this index.
    Set(usize),
}

/// A value and where it was written.
#[derive(Debug)]
struct Node {
    origin: Origin,
    content: Content,
}

/// A value.
#[derive(Debug)]
enum Content {
    Text(String),
    Integer(i64),
    Float(f64),
    Boolean(bool),
    Date,
    Array(Vec<Node>),
    Table(BTreeMap<String, Node>),
}

impl Content {
    /// What it is, for a message that says what it should have been.
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
}

impl Node {
    /// Tells of it and of all that is in it.
    fn written(&self, key: &str, tell: &mut dyn FnMut(&str, Origin)) {
        tell(key, self.origin);
        match &self.content {
            Content::Array(items) => {
                for (i, item) in items.iter().enumerate() {
                    item.written(&format!("{key}[{i}]"), tell);
                }
            }
            Content::Table(entries) => {
                for (name, node) in entries {
                    node.written(&join(key, name), tell);
                }
            }
            _ => {}
        }
    }
}

/// Where the values of a scene file were written, for what is found wrong only when the scene is built.
#[derive(Clone, Debug, Default)]
pub struct Written(BTreeMap<String, Origin>);

impl Written {
    /// Where a value was written, by its dotted key; where it is left out, that of its table.
    pub(super) fn at(&self, key: &str) -> Option<Origin> {
        let ends = key.rmatch_indices(['.', '[']).map(|(end, _)| end);
        let mut keys = std::iter::once(key.len()).chain(ends).chain([0]);
        keys.find_map(|end| self.0.get(&key[..end]).copied())
    }
}

/// What the reader asked of a value.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Asked {
    /// A finite number; `what`, with its unit.
    Number(String),
    /// That it is above zero.
    Positive,
    /// That it lies from the first to the second; and whether these are allowed themselves.
    Within([f64; 2], [bool; 2]),
    /// A list of so many numbers.
    Numbers(usize, String),
    /// Three numbers, or one for all.
    NumberOrVector(String),
    /// A whole number from the first to the second.
    Count(u64, u64, String),
    /// A list of so many of these.
    Counts(usize, u64, u64, String),
    /// `true` or `false`.
    Boolean,
    /// A text.
    Text(String),
    /// One of these words.
    Choice(Vec<String>),
    /// A table with these keys.
    Table(Vec<String>),
    /// A list.
    List,
    /// Of a table: that it has this key.
    Required(String),
    /// Of a table: that it has exactly one of these keys.
    OneOf(Vec<String>),
}

/// A parsed scene file with its overrides.
#[derive(Debug)]
pub(super) struct Document {
    file: PathBuf,
    overrides: Vec<String>,
    root: Node,
    /// Whether it only shows the format: the mesh files that it names do not exist.
    exemplar: bool,
    /// Keys in the order in which they were asked for.
    asked: RefCell<Vec<(String, Asked)>>,
}

impl Document {
    /// Parses the text of `file` and lays the overrides over it.
    pub(super) fn parse(file: &Path, text: &str, overrides: &[String]) -> Result<Document, Error> {
        let line_of = |offset: usize| {
            1 + text.as_bytes()[..offset.min(text.len())]
                .iter()
                .filter(|&&b| b == b'\n')
                .count()
        };
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
            root: Node {
                origin: Origin::Line(last_line),
                content: Content::Table(BTreeMap::new()),
            },
            exemplar: false,
            asked: RefCell::default(),
        };
        document.root.content =
            document.table(root.into_inner(), "", &|span| Origin::Line(line_of(span)))?;
        for index in 0..overrides.len() {
            document.lay_over(index)?;
        }
        Ok(document)
    }

    /// Parses a text that shows the format.
    pub(super) fn exemplar(text: &str) -> Result<Document, Error> {
        Ok(Document {
            exemplar: true,
            ..Document::parse(Path::new("exemplar.toml"), text, &[])?
        })
    }

    /// Whether the mesh files that it names do not exist.
    pub(super) fn is_exemplar(&self) -> bool {
        self.exemplar
    }

    /// Where its values were written.
    pub(super) fn written(&self) -> Written {
        let mut origins = BTreeMap::new();
        self.root.written("", &mut |key, origin| {
            origins.insert(key.to_owned(), origin);
        });
        Written(origins)
    }

    /// Keys, with their indices, and what the reader asked of their values.
    pub(super) fn into_asked(self) -> Vec<(String, Asked)> {
        self.asked.into_inner()
    }

    fn ask(&self, key: &str, asked: Asked) {
        self.asked.borrow_mut().push((key.to_owned(), asked));
    }

    /// The root table.
    pub(super) fn root(&self) -> Place<'_> {
        Place {
            document: self,
            key: String::new(),
            node: &self.root,
        }
    }

    fn table(
        &self,
        table: DeTable<'_>,
        key: &str,
        origin: &dyn Fn(usize) -> Origin,
    ) -> Result<Content, Error> {
        let mut entries = BTreeMap::new();
        for (name, value) in table {
            let name = name.into_inner().into_owned();
            let node = self.node(value, &join(key, &name), origin)?;
            entries.insert(name, node);
        }
        Ok(Content::Table(entries))
    }

    fn node(
        &self,
        value: Spanned<DeValue<'_>>,
        key: &str,
        origin: &dyn Fn(usize) -> Origin,
    ) -> Result<Node, Error> {
        let place = origin(value.span().start);
        let content = match value.into_inner() {
            DeValue::String(text) => Content::Text(text.into_owned()),
            DeValue::Integer(number) => {
                match i64::from_str_radix(number.as_str(), number.radix()) {
                    Ok(number) => Content::Integer(number),
                    Err(_) => {
                        let problem = format!("{number} lies beyond +-2^63");
                        return Err(self.fail(place, key, problem, "write a smaller number"));
                    }
                }
            }
            DeValue::Float(number) => match number.as_str().parse() {
                Ok(number) => Content::Float(number),
                Err(_) => {
                    return Err(self.fail(
                        place,
                        key,
                        format!("{number} is not a number"),
                        "write a number",
                    ));
                }
            },
            DeValue::Boolean(value) => Content::Boolean(value),
            DeValue::Datetime(_) => Content::Date,
            DeValue::Array(items) => {
                let items = items.into_iter().enumerate();
                Content::Array(
                    items
                        .map(|(i, item)| self.node(item, &format!("{key}[{i}]"), origin))
                        .collect::<Result<_, _>>()?,
                )
            }
            DeValue::Table(table) => self.table(table, key, origin)?,
        };
        Ok(Node {
            origin: place,
            content,
        })
    }

    /// Puts the value of one `--set KEY=VALUE` into the tree; tables on the way are made where there are none.
    fn lay_over(&mut self, index: usize) -> Result<(), Error> {
        let origin = Origin::Set(index);
        let setting = self.overrides[index].clone();
        let refuse = |problem: String, cure: String| {
            Err(Error::Input {
                what: format!("--set {setting}"),
                problem,
                cure,
            })
        };
        let Some((path, text)) = setting.split_once('=') else {
            return refuse(
                "has no `=`".into(),
                "write --set KEY=VALUE, such as --set liquid.density=800".into(),
            );
        };
        let Some(steps) = parse_path(path.trim()) else {
            let cure = "write dotted keys, with indices from 0 for lists, such as liquid.region[0].velocity";
            return refuse(format!("`{path}` is not a key"), cure.into());
        };
        let text = text.trim();
        let value = match DeValue::parse(text) {
            Ok(value) => self.node(value, path.trim(), &|_| origin)?,
            // Shells eat quotes, so a bare word stands for a text.
            Err(_)
                if !text.is_empty()
                    && !text.contains(|c: char| c.is_whitespace() || "[]{}\"'=,#".contains(c)) =>
            {
                Node {
                    origin,
                    content: Content::Text(text.to_owned()),
                }
            }
            Err(error) => {
                let cure = "write the value as in the scene file, in single quotes to keep it from the shell";
                return refuse(
                    format!(
                        "`{text}` is not a TOML value: {}",
                        one_line(error.message())
                    ),
                    cure.into(),
                );
            }
        };
        let mut node = &mut self.root;
        let mut key = String::new();
        for step in steps {
            let described = node.content.describe();
            node = match (step, &mut node.content) {
                (Step::Key(name), Content::Table(entries)) => {
                    key = join(&key, &name);
                    let table = || Node {
                        origin,
                        content: Content::Table(BTreeMap::new()),
                    };
                    entries.entry(name).or_insert_with(table)
                }
                (Step::Key(name), Content::Array(items)) => {
                    let problem = format!("`{key}` is a list of {}", items.len());
                    return refuse(problem, format!("say which one: {key}[0].{name}"));
                }
                (Step::Index(i), Content::Array(items)) => {
                    let n = items.len();
                    key = format!("{key}[{i}]");
                    match items.get_mut(i) {
                        Some(item) => item,
                        None => {
                            let cure = match n {
                                0 => "add the entry to the scene file".to_owned(),
                                _ => format!("use an index from 0 to {}", n - 1),
                            };
                            return refuse(
                                format!("there is no `{key}`: the list has {n} entries"),
                                cure,
                            );
                        }
                    }
                }
                (Step::Index(_), Content::Table(entries)) if entries.is_empty() => {
                    let cure = "add the entry to the scene file, or set the whole list";
                    return refuse(format!("there is no list `{key}`"), cure.into());
                }
                (Step::Index(i), _) => {
                    return refuse(
                        format!("`{key}` is {described}, not a list"),
                        format!("leave out the [{i}]"),
                    );
                }
                (Step::Key(name), _) => {
                    return refuse(
                        format!("`{key}` is {described} and has no key `{name}`"),
                        format!("set `{key}`"),
                    );
                }
            };
        }
        *node = value;
        Ok(())
    }

    fn fail(
        &self,
        origin: Origin,
        key: &str,
        problem: impl Into<String>,
        cure: impl Into<String>,
    ) -> Error {
        let (problem, cure) = (problem.into(), cure.into());
        match origin {
            Origin::Line(line) => Error::Scene {
                file: self.file.clone(),
                line,
                key: key.to_owned(),
                problem,
                cure,
            },
            Origin::Set(index) => Error::Input {
                what: format!("--set {}", self.overrides[index]),
                problem: format!("{key}: {problem}"),
                cure,
            },
        }
    }
}

/// A step of a dotted path.
enum Step {
    Key(String),
    Index(usize),
}

/// The steps of `liquid.region[0].box.min[1]`; `None` where it is no path.
fn parse_path(path: &str) -> Option<Vec<Step>> {
    let mut steps = Vec::new();
    for part in path.split('.') {
        let (name, mut indices) = part.split_at(part.find('[').unwrap_or(part.len()));
        if name.is_empty()
            || !name
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
        {
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

fn join(key: &str, name: &str) -> String {
    if key.is_empty() {
        name.to_owned()
    } else {
        format!("{key}.{name}")
    }
}

fn one_line(message: &str) -> String {
    message
        .lines()
        .map(str::trim)
        .collect::<Vec<_>>()
        .join(", ")
}

/// The keys of a table.
pub(super) struct Keys {
    /// Those that mean something.
    pub(super) valid: &'static [&'static str],
    /// Those that one might look for and that are none, with the reason.
    pub(super) absent: &'static [(&'static str, &'static str)],
}

/// A value in the tree.
#[derive(Clone, Debug)]
pub(super) struct Place<'a> {
    document: &'a Document,
    key: String,
    node: &'a Node,
}

impl<'a> Place<'a> {
    /// An error at this value.
    pub(super) fn fail(&self, problem: impl Into<String>, cure: impl Into<String>) -> Error {
        self.document
            .fail(self.node.origin, &self.key, problem, cure)
    }

    /// An error at this value unless `ok`.
    pub(super) fn ensure(
        &self,
        ok: bool,
        problem: impl Into<String>,
        cure: impl Into<String>,
    ) -> Result<(), Error> {
        if ok {
            Ok(())
        } else {
            Err(self.fail(problem, cure))
        }
    }

    /// Whether the mesh files of the scene do not exist.
    pub(super) fn is_exemplar(&self) -> bool {
        self.document.exemplar
    }

    fn ask(&self, asked: Asked) {
        self.document.ask(&self.key, asked);
    }

    /// A number that [`Place::number`] or [`Place::positive`] gave, which must lie in a range; `problem` and `cure` say so.
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
        self.ask(Asked::Within([least, most], [with_least, with_most]));
        self.ensure(range.contains(&value), problem, cure)
    }

    /// Whether an override wrote it.
    pub(super) fn is_override(&self) -> bool {
        matches!(self.node.origin, Origin::Set(_))
    }

    pub(super) fn wrong_type(&self, wanted: &str) -> Error {
        self.fail(
            format!("is {}", self.node.content.describe()),
            format!("write {wanted}"),
        )
    }

    /// A finite number. `what` names it with its unit, such as `a density in kg/m^3`.
    pub(super) fn number(&self, what: &str) -> Result<f64, Error> {
        self.ask(Asked::Number(what.to_owned()));
        let value = match &self.node.content {
            Content::Integer(value) => *value as f64,
            Content::Float(value) => *value,
            Content::Text(text) if text.trim().parse::<f64>().is_ok() => {
                return Err(self.fail(
                    format!("is the text \"{text}\""),
                    format!("write {what} without quotes"),
                ));
            }
            _ => return Err(self.wrong_type(&format!("{what} as one number"))),
        };
        self.ensure(
            value.is_finite(),
            format!("is {value}"),
            format!("write {what} as a finite number"),
        )?;
        Ok(value)
    }

    /// A finite number above zero.
    pub(super) fn positive(&self, what: &str) -> Result<f64, Error> {
        self.ask(Asked::Positive);
        let value = self.number(what)?;
        self.ensure(
            value > 0.0,
            format!("is {value}"),
            format!("write {what} above zero"),
        )?;
        Ok(value)
    }

    /// A list of exactly `N` values.
    fn items<const N: usize>(&self, what: &str) -> Result<[Place<'a>; N], Error> {
        let Content::Array(items) = &self.node.content else {
            return Err(self.wrong_type(&format!("{what} as a list of {N} numbers")));
        };
        let places: Vec<_> = items
            .iter()
            .enumerate()
            .map(|(i, node)| self.item(i, node))
            .collect();
        let n = places.len();
        places.try_into().map_err(|_| {
            self.fail(
                format!("is a list of {n}"),
                format!("write {what} as a list of {N} numbers"),
            )
        })
    }

    fn item(&self, i: usize, node: &'a Node) -> Place<'a> {
        Place {
            document: self.document,
            key: format!("{}[{i}]", self.key),
            node,
        }
    }

    /// A list of `N` finite numbers.
    pub(super) fn numbers<const N: usize>(&self, what: &str) -> Result<[f64; N], Error> {
        self.ask(Asked::Numbers(N, what.to_owned()));
        let mut values = [0.0; N];
        for (value, place) in values.iter_mut().zip(self.items::<N>(what)?) {
            *value = place.number(what)?;
        }
        Ok(values)
    }

    /// Three finite numbers.
    pub(super) fn vector(&self, what: &str) -> Result<DVec3, Error> {
        Ok(DVec3::from_array(self.numbers::<3>(what)?))
    }

    /// Three finite numbers, or one that stands for all three.
    pub(super) fn number_or_vector(&self, what: &str) -> Result<DVec3, Error> {
        self.ask(Asked::NumberOrVector(what.to_owned()));
        match self.node.content {
            Content::Integer(_) | Content::Float(_) => self.number(what).map(DVec3::splat),
            _ => self.vector(what),
        }
    }

    /// A direction of any length but zero, as a unit vector.
    pub(super) fn direction(&self, what: &str) -> Result<DVec3, Error> {
        let vector = self.vector(what)?;
        vector.try_normalize().ok_or_else(|| {
            let [x, y, z] = vector.to_array();
            self.fail(
                format!("is [{x}, {y}, {z}], which has no direction"),
                format!("write {what}, such as [0, 1, 0]"),
            )
        })
    }

    /// A whole number from `min` to `max`.
    pub(super) fn count(&self, what: &str, min: u64, max: u64) -> Result<u64, Error> {
        self.ask(Asked::Count(min, max, what.to_owned()));
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
    pub(super) fn counts<const N: usize>(
        &self,
        what: &str,
        min: u64,
        max: u64,
    ) -> Result<[usize; N], Error> {
        self.ask(Asked::Counts(N, min, max, what.to_owned()));
        let mut values = [0; N];
        for (value, place) in values.iter_mut().zip(self.items::<N>(what)?) {
            *value = place.count(what, min, max)? as usize;
        }
        Ok(values)
    }

    /// `true` or `false`.
    pub(super) fn boolean(&self) -> Result<bool, Error> {
        self.ask(Asked::Boolean);
        match self.node.content {
            Content::Boolean(value) => Ok(value),
            _ => Err(self.wrong_type("true or false, without quotes")),
        }
    }

    /// A text that is not empty.
    pub(super) fn text(&self, what: &str) -> Result<&'a str, Error> {
        self.ask(Asked::Text(what.to_owned()));
        match &self.node.content {
            Content::Text(text) if text.is_empty() => {
                Err(self.fail("is empty", format!("write {what}")))
            }
            Content::Text(text) => Ok(text),
            _ => Err(self.wrong_type(&format!("{what} in quotes"))),
        }
    }

    /// One of some words of the format.
    pub(super) fn choice<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T, Error> {
        let words = choices.iter().map(|(word, _)| (*word).to_owned());
        self.ask(Asked::Choice(words.collect()));
        self.one_word(choices)
    }

    /// One of the names that this scene gives; `what` is named so.
    pub(super) fn named<T: Copy>(&self, what: &str, names: &[(&str, T)]) -> Result<T, Error> {
        self.ask(Asked::Text(what.to_owned()));
        self.one_word(names)
    }

    fn one_word<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T, Error> {
        let words: Vec<_> = choices
            .iter()
            .map(|(word, _)| format!("\"{word}\""))
            .collect();
        let wanted = format!("one of {}", words.join(", "));
        match &self.node.content {
            Content::Text(text) => match choices.iter().find(|(word, _)| word == text) {
                Some(&(_, value)) => Ok(value),
                None => Err(self.wrong_type(&wanted)),
            },
            _ => Err(self.wrong_type(&wanted)),
        }
    }

    /// A table that has none but the keys given.
    pub(super) fn table(self, keys: &Keys) -> Result<Table<'a>, Error> {
        let valid = keys.valid.iter().map(|&key| key.to_owned());
        self.ask(Asked::Table(valid.collect()));
        let Content::Table(entries) = &self.node.content else {
            return Err(match &self.node.content {
                Content::Array(_) => self.fail(
                    "is a list",
                    format!("write one table: [{}] with single brackets", self.key),
                ),
                Content::Text(name) if keys.valid.contains(&"file") => {
                    self.wrong_type(&format!("{{ file = {name:?} }}"))
                }
                _ => self.wrong_type(&format!("a table with the keys {}", keys.valid.join(", "))),
            });
        };
        let unknown = entries
            .iter()
            .filter(|(name, _)| !keys.valid.contains(&name.as_str()));
        let first = unknown.min_by_key(|(_, node)| match node.origin {
            Origin::Line(line) => (0, line),
            Origin::Set(index) => (1, index),
        });
        if let Some((name, node)) = first {
            let place = Place {
                document: self.document,
                key: join(&self.key, name),
                node,
            };
            if let Some((_, reason)) = keys.absent.iter().find(|(absent, _)| absent == name) {
                return Err(place.fail(format!("is no key: {reason}"), format!("remove `{name}`")));
            }
            let nearest = keys
                .valid
                .iter()
                .map(|valid| (strsim::damerau_levenshtein(name, valid), *valid))
                .filter(|(distance, valid)| *distance <= (name.len().max(valid.len()) / 3).max(1))
                .min();
            let list = format!("the keys here are {}", keys.valid.join(", "));
            let cure = match (suggestion(name, keys.valid), nearest) {
                (Some(Suggestion::Absent(reason)), None) => {
                    let problem = format!("is no key: {reason}");
                    return Err(place.fail(problem, format!("remove `{name}`")));
                }
                (Some(Suggestion::Write(instead)), _) => format!("write {instead}; {list}"),
                (Some(Suggestion::Key(valid)), _) | (_, Some((_, valid))) => {
                    format!("did you mean `{valid}`? {list}")
                }
                (None, None) => list,
            };
            return Err(place.fail("unknown key", cure));
        }
        Ok(Table {
            place: self,
            entries,
        })
    }

    /// The entries of a list of tables.
    pub(super) fn list(&self) -> Result<Vec<Place<'a>>, Error> {
        self.ask(Asked::List);
        match &self.node.content {
            Content::Array(items) => Ok(items
                .iter()
                .enumerate()
                .map(|(i, node)| self.item(i, node))
                .collect()),
            Content::Table(_) => Err(self.fail(
                "is one table, not a list",
                format!("write [[{}]] with double brackets", self.key),
            )),
            _ => Err(self.wrong_type(&format!("a list: [[{}]] before each entry", self.key))),
        }
    }
}

/// A table whose keys are all known.
#[derive(Clone, Debug)]
pub(super) struct Table<'a> {
    place: Place<'a>,
    entries: &'a BTreeMap<String, Node>,
}

impl<'a> Table<'a> {
    /// The value of a key, where it is given.
    pub(super) fn get(&self, name: &str) -> Option<Place<'a>> {
        let node = self.entries.get(name)?;
        Some(Place {
            document: self.place.document,
            key: join(&self.place.key, name),
            node,
        })
    }

    /// The value of a key that must be given. `example` is the line that would be right.
    pub(super) fn required(&self, name: &str, example: &str) -> Result<Place<'a>, Error> {
        self.place.ask(Asked::Required(name.to_owned()));
        self.get(name).ok_or_else(|| {
            let key = join(&self.place.key, name);
            self.place.document.fail(
                self.place.node.origin,
                &key,
                "is missing",
                format!("write {example}"),
            )
        })
    }

    /// The one of several keys that is given, with its value.
    pub(super) fn one_of<'k>(
        &self,
        names: &[&'k str],
        what: &str,
    ) -> Result<(&'k str, Place<'a>), Error> {
        let all = names.iter().map(|&name| name.to_owned());
        self.place.ask(Asked::OneOf(all.collect()));
        let mut given = names
            .iter()
            .filter_map(|&name| Some((name, self.get(name)?)));
        match (given.next(), given.next()) {
            (Some(one), None) => Ok(one),
            (None, _) => Err(self.fail(
                format!("has no {what}"),
                format!("add one of {}", names.join(", ")),
            )),
            (Some((first, _)), Some((second, _))) => Err(self.fail(
                format!("has `{first}` and `{second}`"),
                format!("keep one {what}"),
            )),
        }
    }

    /// An error at the table.
    pub(super) fn fail(&self, problem: impl Into<String>, cure: impl Into<String>) -> Error {
        self.place.fail(problem, cure)
    }
}
