//! The JSON schema of scene files. It is what the reader asks of scenes that have every key of the format, so that the two cannot
//! disagree; units, defaults and meanings are those of docs/scene.md.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::{Map, Value, json};

use super::Scene;
use super::document::{Asked, Document};
use crate::error::Error;

/// Scenes that have every key of the format between them; what is required is required in all of them. The mesh files that they name
/// do not exist.
pub const EXEMPLARS: [&str; 3] = [
    include_str!("exemplars/both.toml"),
    include_str!("exemplars/liquid.toml"),
    include_str!("exemplars/solids.toml"),
];
/// The page that describes the format.
const PAGE: &str = include_str!("../../docs/scene.md");
/// Tables that hold shapes; [`PAGE`] describes these in one place.
const SHAPE_HOLDERS: [&str; 4] = ["region", "obstacle", "source", "sink"];

/// The schema (draft 2020-12) of the TOML files that [`Scene::load`] reads. What depends on several keys at once only the reader checks.
///
/// # Errors
/// Those of the exemplars, which have none.
pub fn schema() -> Result<Value, Error> {
    let mut format = Format {
        page: page(),
        ..Format::default()
    };
    for (number, text) in EXEMPLARS.into_iter().enumerate() {
        let document = Document::exemplar(text)?;
        Scene::of_document(&document, Path::new("exemplar.toml"), text, &[], 1.0)?;
        for (key, asked) in document.into_asked() {
            format.note(number, &key, asked);
        }
    }
    let mut schema = format.schema("");
    let head = json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "cutwater scene",
        "description": "A scene of liquids and elastic solids for cutwater. Lengths in m, times in s, masses in kg.",
    });
    if let (Some(schema), Value::Object(head)) = (schema.as_object_mut(), head) {
        schema.extend(head);
    }
    Ok(schema)
}

/// What the page says of a key.
#[derive(Clone, Debug, Default)]
struct Words {
    unit: String,
    default: String,
    meaning: String,
}

/// What the reader asked, by key; indices of lists are left out: `solid[].pin[].region`.
#[derive(Debug, Default)]
struct Format {
    asked: BTreeMap<String, Vec<Asked>>,
    /// Of each table: what was asked of it in each place where it stands.
    tables: BTreeMap<String, BTreeMap<String, BTreeSet<String>>>,
    page: BTreeMap<String, Words>,
}

impl Format {
    fn note(&mut self, exemplar: usize, key: &str, asked: Asked) {
        let path = without_indices(key);
        let places = self.tables.entry(path.clone()).or_default();
        let place = format!("{exemplar} {key}");
        match &asked {
            Asked::Table(_) => {
                places.entry(place).or_default();
            }
            Asked::Required(name) => {
                places.entry(place).or_default().insert(name.clone());
            }
            _ => {}
        }
        let all = self.asked.entry(path).or_default();
        if !all.contains(&asked) {
            all.push(asked);
        }
    }

    /// The schema of the value with this path.
    fn schema(&self, path: &str) -> Value {
        let mut schema = Map::new();
        let asked = self.asked.get(path).map_or(&[][..], |asked| asked);
        let either = asked
            .iter()
            .find(|asked| matches!(asked, Asked::NumberOrVector(_)));
        // Of one that may be either, the reader then asked for that which the exemplar has.
        for one in either.map_or(asked, std::slice::from_ref) {
            self.add(&mut schema, path, one);
        }
        let what = asked.iter().find_map(|asked| match asked {
            Asked::Number(what)
            | Asked::Numbers(_, what)
            | Asked::NumberOrVector(what)
            | Asked::Count(_, _, what)
            | Asked::Counts(_, _, _, what)
            | Asked::Text(what) => Some(what.clone()),
            _ => None,
        });
        let words = self.words(path);
        let described = words
            .as_ref()
            .map(Words::sentence)
            .filter(|sentence| !sentence.is_empty());
        if let Some(description) = described.or(what) {
            schema.insert("description".to_owned(), description.into());
        }
        if let Some(default) = words.and_then(|words| words.default_value()) {
            schema.insert("default".to_owned(), default);
        }
        Value::Object(schema)
    }

    fn add(&self, schema: &mut Map<String, Value>, path: &str, asked: &Asked) {
        let number = || json!({ "type": "number" });
        let list = |n: usize, items: Value| json!({ "type": "array", "items": items, "minItems": n, "maxItems": n });
        let count =
            |min: u64, max: u64| json!({ "type": "integer", "minimum": min, "maximum": max });
        let added = match asked {
            Asked::Number(_) => number(),
            Asked::Positive => json!({ "type": "number", "exclusiveMinimum": 0 }),
            Asked::Within(ends, with) => {
                let mut range = Map::new();
                let names = [
                    ["exclusiveMinimum", "minimum"],
                    ["exclusiveMaximum", "maximum"],
                ];
                for ((end, with), names) in ends.iter().zip(with).zip(names) {
                    if end.is_finite() {
                        range.insert(names[usize::from(*with)].to_owned(), json!(end));
                    }
                }
                Value::Object(range)
            }
            Asked::Numbers(n, _) => list(*n, number()),
            Asked::NumberOrVector(_) => json!({ "anyOf": [number(), list(3, number())] }),
            Asked::Count(min, max, _) => count(*min, *max),
            Asked::Counts(n, min, max, _) => list(*n, count(*min, *max)),
            Asked::Boolean => json!({ "type": "boolean" }),
            Asked::Text(_) => json!({ "type": "string", "minLength": 1 }),
            Asked::Choice(words) => json!({ "type": "string", "enum": words }),
            Asked::Table(keys) => {
                let property = |key: &String| (key.clone(), self.schema(&join(path, key)));
                let properties: Map<String, Value> = keys.iter().map(property).collect();
                let mut table = json!({ "type": "object", "properties": properties, "additionalProperties": false });
                let required = self.required(path);
                if !required.is_empty() {
                    table["required"] = json!(required);
                }
                table
            }
            Asked::List => json!({ "type": "array", "items": self.schema(&format!("{path}[]")) }),
            Asked::OneOf(keys) => {
                let each: Vec<Value> = keys
                    .iter()
                    .map(|key| json!({ "required": [key] }))
                    .collect();
                // A second choice of the same table stands beside the first.
                match schema.contains_key("oneOf") {
                    true => json!({ "allOf": [{ "oneOf": each }] }),
                    false => json!({ "oneOf": each }),
                }
            }
            Asked::Required(_) => return,
        };
        if let Value::Object(added) = added {
            schema.extend(added);
        }
    }

    /// The keys that a table must have wherever it stands.
    fn required(&self, path: &str) -> BTreeSet<String> {
        let places = self.tables.get(path).into_iter().flat_map(BTreeMap::values);
        places
            .cloned()
            .reduce(|all, here| &all & &here)
            .unwrap_or_default()
    }

    fn words(&self, path: &str) -> Option<Words> {
        let plain = path.replace("[]", "");
        let of_shape = || {
            let (holder, shape) = plain.rsplit_once('.')?;
            let holder = holder.rsplit('.').next()?;
            let is_shape = SHAPE_HOLDERS.contains(&holder);
            self.page
                .get(&format!("shapes.{shape}"))
                .filter(|_| is_shape)
        };
        // An entry of a list has the words of the list.
        let words = self.page.get(&plain).or_else(of_shape);
        words.filter(|_| !path.ends_with("[]")).cloned()
    }
}

impl Words {
    fn sentence(&self) -> String {
        let default = match self.default.as_str() {
            "" | "required" => self.default.clone(),
            default => format!("default: {default}"),
        };
        let parts = [&self.unit, &self.meaning, &default];
        let parts: Vec<&str> = parts
            .into_iter()
            .map(String::as_str)
            .filter(|part| !part.is_empty())
            .collect();
        parts.join("; ")
    }

    /// The default, where it is a value and not words.
    fn default_value(&self) -> Option<Value> {
        let text = self.default.trim_matches('`');
        serde_json::from_str(text).ok()
    }
}

fn without_indices(key: &str) -> String {
    let mut path = String::new();
    for part in key.split_inclusive(['[', ']']) {
        match part.strip_suffix(']') {
            Some(_) => path.push(']'),
            None => path.push_str(part),
        }
    }
    path
}

fn join(path: &str, key: &str) -> String {
    match path {
        "" => key.to_owned(),
        _ => format!("{path}.{key}"),
    }
}

/// The rows of the page's tables, by the key that each is about: `solid.pin.region`, `shapes.box`.
fn page() -> BTreeMap<String, Words> {
    let mut rows = BTreeMap::new();
    let (mut section, mut columns) = (String::new(), Vec::new());
    for line in PAGE.lines() {
        if line.starts_with('#') {
            let title = line.trim_start_matches('#').trim();
            section = match title {
                "Meshes" => "solid.mesh".to_owned(),
                _ => title.to_lowercase().replace(['`', '[', ']'], ""),
            };
            columns.clear();
        }
        let Some(cells) = line
            .strip_prefix('|')
            .and_then(|line| line.strip_suffix('|'))
        else {
            columns.clear();
            continue;
        };
        let cells: Vec<String> = cells.split('|').map(|cell| plain(cell.trim())).collect();
        if columns.is_empty() {
            columns = cells;
            continue;
        }
        let cell = |names: &[&str]| {
            let at = columns
                .iter()
                .position(|column| names.contains(&column.as_str()));
            at.and_then(|at| cells.get(at)).cloned().unwrap_or_default()
        };
        let words = Words {
            unit: cell(&["unit", "keys"]),
            default: cell(&["default"]),
            meaning: cell(&["meaning"]),
        };
        // A row may be about several keys.
        for key in cells[0].split(", ") {
            rows.insert(join(&section, key.trim_matches('`')), words.clone());
        }
    }
    rows
}

/// A text without the addresses of its links.
fn plain(text: &str) -> String {
    let mut plain = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once("](") {
        let (start, label) = before.rsplit_once('[').unwrap_or((before, ""));
        plain += start;
        plain += label;
        rest = after.split_once(')').map_or("", |(_, rest)| rest);
    }
    plain + rest
}
