//! The JSON schema of scene files, derived from the reader's queries of scenes with every key of the format.
//!
//! Reader and schema therefore agree. Units, defaults and meanings are those of docs/scene.md.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::{Map, Value, json};

use super::Scene;
use super::document::{Document, Query, join};
use crate::error::Error;

/// Scenes that together have every key of the format. A required key is required in all of them. Their mesh files do not exist.
pub const EXEMPLARS: [&str; 4] = [
    include_str!("exemplars/both.toml"),
    include_str!("exemplars/liquid.toml"),
    include_str!("exemplars/solids.toml"),
    include_str!("exemplars/slab.toml"),
];
const PAGE: &str = include_str!("../../docs/scene.md");
/// Tables that contain shapes. [`PAGE`] describes shapes in one place.
const SHAPE_HOLDERS: [&str; 4] = ["region", "obstacle", "source", "sink"];

/// The schema (draft 2020-12) of the TOML files that [`Scene::load`] reads. Only the reader checks conditions on several keys.
pub fn schema() -> Result<Value, Error> {
    let mut format = Format { page: page(), ..Format::default() };
    for (number, text) in EXEMPLARS.into_iter().enumerate() {
        let document = Document::exemplar(text)?;
        Scene::from_document(&document, Path::new("exemplar.toml"), text, &[], 1.0)?;
        for (key, query) in document.into_queries() {
            format.add_query(number, &key, query);
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

/// Documentation of a key.
#[derive(Clone, Debug, Default)]
struct KeyDocs {
    unit: String,
    default: String,
    meaning: String,
}

/// Queries by path, a key without list indices: `solid[].pin[].region`.
#[derive(Debug, Default)]
struct Format {
    queries: BTreeMap<String, Vec<Query>>,
    /// Required keys of each occurrence of each table.
    required: BTreeMap<String, BTreeMap<String, BTreeSet<String>>>,
    page: BTreeMap<String, KeyDocs>,
}

impl Format {
    fn add_query(&mut self, exemplar: usize, key: &str, query: Query) {
        let path = without_indices(key);
        let occurrences = self.required.entry(path.clone()).or_default();
        let occurrence = format!("{exemplar} {key}");
        match &query {
            Query::Table(_) => {
                occurrences.entry(occurrence).or_default();
            }
            Query::Required(name) => {
                let keys = occurrences.entry(occurrence).or_default();
                keys.insert(name.clone());
            }
            _ => {}
        }
        let all = self.queries.entry(path).or_default();
        if !all.contains(&query) {
            all.push(query);
        }
    }

    /// The schema of the value with this path.
    fn schema(&self, path: &str) -> Value {
        let mut schema = Map::new();
        let queries = self.queries.get(path).map_or(&[][..], |queries| queries);
        let either = queries.iter().find(|query| matches!(query, Query::NumberOrVector(_)));
        // `NumberOrVector` is followed by a query of the exemplar's own type, which would narrow the schema.
        for query in either.map_or(queries, std::slice::from_ref) {
            self.add(&mut schema, path, query);
        }
        let what = queries.iter().find_map(|query| match query {
            Query::Number(what)
            | Query::Numbers(_, what)
            | Query::NumberOrVector(what)
            | Query::Count(_, _, what)
            | Query::Counts(_, _, _, what)
            | Query::Text(what) => Some(what.clone()),
            _ => None,
        });
        let docs = self.docs(path);
        let described = docs.as_ref().map(KeyDocs::sentence).filter(|sentence| !sentence.is_empty());
        if let Some(description) = described.or(what) {
            schema.insert("description".to_owned(), description.into());
        }
        if let Some(default) = docs.and_then(|docs| docs.default_value()) {
            schema.insert("default".to_owned(), default);
        }
        Value::Object(schema)
    }

    fn add(&self, schema: &mut Map<String, Value>, path: &str, query: &Query) {
        let number = || json!({ "type": "number" });
        let list = |n: usize, items: Value| json!({ "type": "array", "items": items, "minItems": n, "maxItems": n });
        let count = |min: u64, max: u64| json!({ "type": "integer", "minimum": min, "maximum": max });
        let added = match query {
            Query::Number(_) => number(),
            Query::Positive => json!({ "type": "number", "exclusiveMinimum": 0 }),
            Query::Within(ends, with) => {
                let mut range = Map::new();
                let names = [["exclusiveMinimum", "minimum"], ["exclusiveMaximum", "maximum"]];
                for ((end, with), names) in ends.iter().zip(with).zip(names) {
                    if end.is_finite() {
                        range.insert(names[usize::from(*with)].to_owned(), json!(end));
                    }
                }
                Value::Object(range)
            }
            Query::Numbers(n, _) => list(*n, number()),
            Query::NumberOrVector(_) => json!({ "anyOf": [number(), list(3, number())] }),
            Query::Count(min, max, _) => count(*min, *max),
            Query::Counts(n, min, max, _) => list(*n, count(*min, *max)),
            Query::Boolean => json!({ "type": "boolean" }),
            Query::Text(_) => json!({ "type": "string", "minLength": 1 }),
            Query::Choice(words) => json!({ "type": "string", "enum": words }),
            Query::Table(keys) => {
                let property = |key: &String| (key.clone(), self.schema(&join(path, key)));
                let properties: Map<String, Value> = keys.iter().map(property).collect();
                let mut table = json!({ "type": "object", "properties": properties, "additionalProperties": false });
                let required = self.required(path);
                if !required.is_empty() {
                    table["required"] = json!(required);
                }
                table
            }
            Query::List => json!({ "type": "array", "items": self.schema(&format!("{path}[]")) }),
            Query::OneOf(keys) => {
                let each: Vec<Value> = keys.iter().map(|key| json!({ "required": [key] })).collect();
                // A table may have two such choices.
                match schema.contains_key("oneOf") {
                    true => json!({ "allOf": [{ "oneOf": each }] }),
                    false => json!({ "oneOf": each }),
                }
            }
            Query::Required(_) => return,
        };
        if let Value::Object(added) = added {
            schema.extend(added);
        }
    }

    /// The keys that all occurrences of a table require.
    fn required(&self, path: &str) -> BTreeSet<String> {
        let occurrences = self.required.get(path).into_iter();
        occurrences.flat_map(BTreeMap::values).cloned().reduce(|all, here| &all & &here).unwrap_or_default()
    }

    fn docs(&self, path: &str) -> Option<KeyDocs> {
        let plain = path.replace("[]", "");
        let shape_docs = || {
            let (holder, shape) = plain.rsplit_once('.')?;
            let holder = holder.rsplit('.').next()?;
            let is_shape = SHAPE_HOLDERS.contains(&holder);
            self.page.get(&format!("shapes.{shape}")).filter(|_| is_shape)
        };
        let docs = self.page.get(&plain).or_else(shape_docs);
        // The list itself has the description, its entries have none.
        docs.filter(|_| !path.ends_with("[]")).cloned()
    }
}

impl KeyDocs {
    fn sentence(&self) -> String {
        let default = match self.default.as_str() {
            "" | "required" => self.default.clone(),
            default => format!("default: {default}"),
        };
        let parts = [&self.unit, &self.meaning, &default];
        let parts: Vec<&str> = parts.into_iter().map(String::as_str).filter(|part| !part.is_empty()).collect();
        parts.join("; ")
    }

    /// The default if it is a value rather than prose.
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

/// Rows of the page's tables by key: `solid.pin.region`, `shapes.box`.
fn page() -> BTreeMap<String, KeyDocs> {
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
        let Some(cells) = line.strip_prefix('|').and_then(|line| line.strip_suffix('|')) else {
            columns.clear();
            continue;
        };
        let cells: Vec<String> = cells.split('|').map(|cell| plain(cell.trim())).collect();
        if columns.is_empty() {
            columns = cells;
            continue;
        }
        let cell = |names: &[&str]| {
            let at = columns.iter().position(|column| names.contains(&column.as_str()));
            at.and_then(|at| cells.get(at)).cloned().unwrap_or_default()
        };
        let docs = KeyDocs { unit: cell(&["unit", "keys"]), default: cell(&["default"]), meaning: cell(&["meaning"]) };
        // A row may describe several keys.
        for key in cells[0].split(", ") {
            rows.insert(join(&section, key.trim_matches('`')), docs.clone());
        }
    }
    rows
}

/// Markdown without the addresses of its links.
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
