//! Scenes merged from parts: families of scenes that share most of their keys.

use serde::de::DeserializeOwned;
use toml::Value;

use crate::Error;

/// Part of a scene: keys and values as in a scene file. Its text is TOML.
pub type Part = toml::Table;

/// Reads a TOML text that is no scene; `what`: its name.
///
/// # Errors
/// [`Error::Input`] where the text is not such a value.
pub fn from_toml<T: DeserializeOwned>(what: &str, text: &str) -> Result<T, Error> {
    toml::from_str(text).map_err(|problem| {
        let problem = problem.to_string();
        Error::input(what, problem, "correct the file and build cutwater again")
    })
}

/// Merges a part into another. Tables are merged key by key and lists entry by entry; other values are replaced.
pub fn merge(into: &mut Part, part: &Part) {
    for (key, value) in part {
        match into.get_mut(key) {
            Some(old) => merge_values(old, value),
            None => drop(into.insert(key.clone(), value.clone())),
        }
    }
}

fn merge_values(old: &mut Value, new: &Value) {
    match (old, new) {
        (Value::Table(old), Value::Table(new)) => merge(old, new),
        (Value::Array(old), Value::Array(new)) if new.iter().all(Value::is_table) => {
            let kept = old.len().min(new.len());
            old.iter_mut().zip(new).for_each(|(old, new)| merge_values(old, new));
            old.extend_from_slice(&new[kept..]);
        }
        (old, new) => *old = new.clone(),
    }
}
