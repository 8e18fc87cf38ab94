//! `--without KEY`: removes parts of a scene, and the keys that refer to them.
//!
//! Keys are those of the file with `--set` applied. Removals that follow each other use the indices before the first of them. An entry of a
//! list is selected by its index from 0, or by its name: `solid[0]`, `solid.wall`, `domain.open.+x`.

use std::collections::BTreeMap;

use super::document::{Content, Node, Step};
use super::probe::{FORCE_MEASUREMENT, LIQUID_MEASUREMENTS, MEASUREMENTS};

/// Begins an override that removes a key.
const WITHOUT: &str = "without ";
/// Before that: the removals before it come first, so its indices count what they leave.
const THEN: &str = "then ";

/// The override that removes a key, for the list of `KEY=VALUE`.
pub fn without(key: &str) -> String {
    format!("{WITHOUT}{}", key.trim())
}

/// Whether an override is looked up together with the one before it: both set values, or both are removals at one time.
pub(super) fn is_continued(before: &str, setting: &str) -> bool {
    let [one, other] = [before, setting].map(|setting| override_option(setting)[0]);
    one == other && !setting.starts_with(THEN)
}

/// Option of the command line for an override, and its value.
pub fn override_option(setting: &str) -> [&str; 2] {
    match setting.strip_prefix(THEN).unwrap_or(setting).strip_prefix(WITHOUT) {
        Some(key) => ["--without", key],
        None => ["--set", setting],
    }
}

/// Keys of an output of liquid.
const LIQUID_OUTPUTS: [&str; 3] = ["particles", "fields", "surface"];
/// Keys of the solver for liquid with solids.
const COUPLED_SOLVER: [&str; 4] = ["coupling", "pressure_on_patches", "formulation", "face_areas"];

/// Removes keys from the tree of a scene. Returns what was removed because it refers to them, as keys and names.
///
/// # Errors
/// The number of the key, with problem and cure.
pub(super) fn remove(root: &mut Node, keys: &[&str]) -> Result<Vec<String>, (usize, [String; 2])> {
    let [had_liquid, had_solids] = ["liquid", "solid"].map(|key| root.child(key).is_some());
    let solids_before = names(root);
    let paths = keys
        .iter()
        .enumerate()
        .map(|(number, key)| root.find(key).map_err(|[problem, cure]| (number, [problem, cure])));
    let mut paths = paths.collect::<Result<Vec<_>, _>>()?;
    // From behind, so that indices stay valid.
    paths.sort();
    paths.dedup();
    for path in paths.iter().rev() {
        root.remove(path);
    }
    let [liquid, solids] = ["liquid", "solid"].map(|key| root.child(key).is_some());
    if (had_liquid || had_solids) && !(liquid || solids) {
        let problem = "leaves neither liquid nor solids".to_owned();
        return Err((0, [problem, "keep one of them".to_owned()]));
    }
    let mut keys: Vec<String> = Vec::new();
    let mut add = |table: &str, names: &[&str]| {
        keys.extend(names.iter().map(|name| match table {
            "" => (*name).to_owned(),
            table => format!("{table}.{name}"),
        }));
    };
    let no_liquid = had_liquid && !liquid;
    let no_solids = had_solids && !solids;
    if no_liquid {
        add("", &["source", "sink", "surface"]);
        add("domain", &["open"]);
        add("output", &LIQUID_OUTPUTS);
        add("solver", &["preconditioner"]);
    }
    if no_solids {
        add("domain", &["friction"]);
        add("output", &["solids"]);
        add("solver", &["solid_contact"]);
    }
    if no_liquid || no_solids {
        add("solver", &COUPLED_SOLVER);
        let block = |node: &Node| matches!(&node.content, Content::Text(word) if word == "block_jacobi");
        let solver = root.child("solver");
        if solver.and_then(|solver| solver.child("preconditioner")).is_some_and(block) {
            add("solver", &["preconditioner"]);
        }
    }
    let mut gone = Vec::new();
    for key in keys {
        if let Ok(path) = root.find(&key) {
            root.remove(&path);
            gone.push(key);
        }
    }
    let left = names(root);
    let lost = |name: &str| solids_before.iter().any(|solid| solid == name) && !left.iter().any(|solid| solid == name);
    gone.extend(remove_probes(root, no_liquid, &lost));
    Ok(gone)
}

/// Names of the solids.
fn names(root: &Node) -> Vec<String> {
    let solids = root.child("solid").map(|list| &list.content);
    let Some(Content::Array(solids)) = solids else {
        return Vec::new();
    };
    solids.iter().filter_map(|solid| Some(solid.label()?.to_owned())).collect()
}

/// Removes probes of liquid that is gone, and of solids whose names are `lost`. Returns their names.
fn remove_probes(root: &mut Node, no_liquid: bool, lost: &dyn Fn(&str) -> bool) -> Vec<String> {
    let Content::Table(entries) = &mut root.content else {
        return Vec::new();
    };
    let Some(Content::Array(probes)) = entries.get_mut("probe").map(|list| &mut list.content) else {
        return Vec::new();
    };
    let refers = |probe: &Node| {
        let of_liquid = LIQUID_MEASUREMENTS.iter().chain([&FORCE_MEASUREMENT]);
        let of_solid = MEASUREMENTS.iter().filter_map(|kind| {
            let measurement = probe.child(kind)?;
            let solid = measurement.child("solid").or_else(|| measurement.child("name"))?;
            match &solid.content {
                Content::Text(name) => Some(name.as_str()),
                _ => None,
            }
        });
        no_liquid && of_liquid.into_iter().any(|kind| probe.child(kind).is_some()) || of_solid.into_iter().any(lost)
    };
    let mut gone = Vec::new();
    let mut number = 0;
    probes.retain(|probe| {
        let remove = refers(probe);
        if remove {
            gone.push(match probe.label() {
                Some(name) => format!("probe {name:?}"),
                None => format!("probe[{number}]"),
            });
        }
        number += 1;
        !remove
    });
    if probes.is_empty() {
        entries.remove("probe");
    }
    gone
}

impl Node {
    /// An entry of a table.
    fn child(&self, name: &str) -> Option<&Node> {
        match &self.content {
            Content::Table(entries) => entries.get(name),
            _ => None,
        }
    }

    /// Name of an entry of a list: its key `name`, or the text that it is.
    pub(super) fn label(&self) -> Option<&str> {
        match &self.content {
            Content::Text(text) => Some(text),
            Content::Table(entries) => entries.get("name").and_then(|name| match &name.content {
                Content::Text(text) => Some(text.as_str()),
                _ => None,
            }),
            _ => None,
        }
    }

    /// Steps to an existing key, with names in lists resolved to indices.
    ///
    /// # Errors
    /// Problem and cure.
    fn find(&self, path: &str) -> Result<Vec<Step>, [String; 2]> {
        let example = || "write a key of the scene, such as liquid, solid[0], solid.NAME or obstacle[1]".to_owned();
        let (mut node, mut steps, mut rest) = (self, Vec::new(), path);
        loop {
            let at = &path[..path.len() - rest.len()].trim_end_matches('.');
            let absent = |name: &str, known: Vec<String>| {
                Err([
                    format!("there is no `{name}` in {}", if at.is_empty() { "the scene" } else { at }),
                    match known.is_empty() {
                        true => example(),
                        false => format!("choose one of {}", known.join(", ")),
                    },
                ])
            };
            match &node.content {
                Content::Table(entries) => {
                    let name = &rest[..rest.find(['.', '[']).unwrap_or(rest.len())];
                    let Some(next) = entries.get(name) else {
                        return absent(name, entries.keys().cloned().collect());
                    };
                    steps.push(Step::Key(name.to_owned()));
                    (node, rest) = (next, &rest[name.len()..]);
                }
                Content::Array(items) => {
                    let index = rest.strip_prefix('[').and_then(|rest| rest.split_once(']'));
                    let (index, after) = match index {
                        Some((index, after)) => {
                            (index.parse().ok().filter(|&index: &usize| index < items.len()), after)
                        }
                        None => {
                            // The longest name, since names may have points.
                            let ends = |name: &str| {
                                let after = rest.strip_prefix(name)?;
                                (after.is_empty() || after.starts_with(['.', '['])).then_some(after)
                            };
                            let named =
                                (0..).zip(items).filter_map(|(index, item)| Some((index, ends(item.label()?)?)));
                            let longest = named.min_by_key(|(_, after)| after.len());
                            (longest.map(|(index, _)| index), longest.map_or(rest, |(_, after)| after))
                        }
                    };
                    let Some(index) = index else {
                        let known = (0..).zip(items).map(|(index, item): (usize, _)| match item.label() {
                            Some(name) => format!("{at}[{index}] ({name})"),
                            None => format!("{at}[{index}]"),
                        });
                        return absent(rest, known.collect());
                    };
                    steps.push(Step::Index(index));
                    (node, rest) = (&items[index], after);
                }
                _ => return absent(rest, Vec::new()),
            }
            if rest.is_empty() {
                return Ok(steps);
            }
            rest = rest.strip_prefix('.').unwrap_or(rest);
            if rest.is_empty() {
                return Err([format!("`{path}` is not a key"), example()]);
            }
        }
    }

    /// Removes an entry below this node, and lists that this empties. Returns whether this node is such a list.
    fn remove(&mut self, steps: &[Step]) -> bool {
        let Some((step, rest)) = steps.split_first() else {
            return false;
        };
        match (step, &mut self.content) {
            (Step::Key(name), Content::Table(entries)) => {
                if rest.is_empty() || entries.get_mut(name).is_some_and(|next| next.remove(rest)) {
                    entries.remove(name);
                }
                false
            }
            (&Step::Index(index), Content::Array(items)) if index < items.len() => {
                if rest.is_empty() || items[index].remove(rest) {
                    items.remove(index);
                }
                items.is_empty()
            }
            _ => false,
        }
    }

    /// Adds the values below this node by their keys. A list without tables is one value.
    pub(super) fn collect_values(&self, key: &str, values: &mut BTreeMap<String, String>) {
        match &self.content {
            Content::Table(entries) if !entries.is_empty() => {
                for (name, node) in entries {
                    node.collect_values(&super::document::join(key, name), values);
                }
            }
            Content::Array(items) if items.iter().any(|item| matches!(item.content, Content::Table(_))) => {
                for (index, item) in items.iter().enumerate() {
                    item.collect_values(&format!("{key}[{index}]"), values);
                }
            }
            _ => drop(values.insert(key.to_owned(), self.content.written())),
        }
    }
}
