//! Cases of the bench, from `cases.toml`: scenes with strong coupling, each hostile in one way, and the variants of the thesis's section 6.3.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::completed;
use crate::Error;
use crate::measure::bench::table::Row;
use crate::output::write_atomically;
use crate::scene::{Part, Scene, from_toml, merge, names};

/// Length of the beam of scenes/stability.toml, m.
pub(super) const BEAM: f64 = 0.8;
/// Sub-steps of its scene.
const THESIS_STEPS: u64 = 120;
/// Largest deflection of the thesis's stiff beam, over its length.
const STIFF: f64 = 0.1;
/// Largest rise of its end at that deflection, over its length. A beam of constant length rises by 0.6 to 2/3 of the deflection squared: 0.006.
const LEVEL: f64 = 0.01;
/// Least deflection by the wrong buoyancy, over the length of the beam.
const PUSHED_AWAY: f64 = 0.2;
/// Least rise by the wrong buoyancy, over the length: twice the largest correct rise.
const LIFTED: f64 = 0.02;
/// "Extreme distortion": elastic energy over all energy of the start. Liquid and gravity could not supply as much. det F is no measure: bending
/// and shear preserve it.
const TORN: f64 = 1.0;
/// Growth of an unstable beam's speed per sub-step over four of them, 25 times the energy. The added mass ratio of a wet beam is 59 by potential
/// flow around a square; with w dt = 2.9 of the first bending mode it grows by 7.8 (van Brummelen 2009).
const GROWS: f64 = 1.5;
const CASES: &str = include_str!("cases.toml");
const THESIS: &str = include_str!("../../../../scenes/stability.toml");

/// Expected behaviour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum Expected {
    /// The run completes with a bounded energy and finite values.
    #[default]
    #[serde(rename = "completes")]
    Completes,
    /// "the solid undergoing extreme distortion, and the simulation eventually failing"
    #[serde(rename = "fails")]
    Fails,
    /// "pressure-induced buoyancy inaccurately dominates and incorrectly pushes the stiff solid to the surface"
    #[serde(rename = "is pushed away")]
    PushedAway,
    /// The run completes, and the beam stays stiff.
    #[serde(rename = "stays stiff")]
    StaysStiff,
}

names! {
    Expected: "completes" => Completes, "fails" => Fails, "is pushed away" => PushedAway, "stays stiff" => StaysStiff;
}

impl Expected {
    /// Whether the row shows it.
    pub fn holds(self, row: &Row) -> bool {
        let completed = completed(row);
        let (deflection, lift) = (row.number("deflection"), row.number("lift"));
        match self {
            Expected::Completes => completed,
            // The size of an instability is random, its growth is not.
            Expected::Fails => !completed && row.number("growth") >= GROWS && row.number("elastic_ratio") >= TORN,
            Expected::PushedAway => completed && deflection >= PUSHED_AWAY && lift >= LIFTED,
            Expected::StaysStiff => completed && deflection <= STIFF && lift <= LEVEL,
        }
    }
}

/// A case, from an entry of `cases.toml`.
#[derive(Clone, Debug, Deserialize)]
pub struct Case {
    /// Unique name; its first word is the group.
    pub name: String,
    /// Hostile property of the scene.
    pub varies: String,
    /// Sub-steps.
    #[serde(skip)]
    pub steps: u64,
    /// Expected behaviour.
    #[serde(default)]
    pub expected: Expected,
    /// Cause of the failure of a case that is known to fail in the measured table. Its verdict is a failure like any other.
    pub known_failure: Option<String>,
    /// Names of partial scenes, and what the case adds to them.
    #[serde(default)]
    parts: Vec<String>,
    #[serde(flatten)]
    own: Part,
    /// TOML of the whole scene.
    #[serde(skip)]
    text: String,
    #[serde(default, rename = "set")]
    overrides: Vec<String>,
    /// Factor of the cells; absent for 1.
    #[serde(rename = "cells")]
    scale: Option<f64>,
}

impl Case {
    /// Its scene.
    pub fn scene(&self) -> Result<Scene, Error> {
        Scene::parse(format!("{}.toml", self.name).as_ref(), &self.text, &self.overrides, self.scale.unwrap_or(1.0))
    }

    /// Cases that vary the same property.
    pub(super) fn group(&self) -> &str {
        self.name.split_once('_').map_or(&self.name, |(group, _)| group)
    }

    /// Writes the scene file; the thesis's is among the project's scenes.
    pub(super) fn write(&self, folder: &Path) -> Result<(), Error> {
        if self.group() == "thesis" {
            return Ok(());
        }
        let text = format!("# {}.\n\n{}", self.varies, self.text);
        write_atomically(&folder.join(format!("{}.toml", self.name)), text.as_bytes())
    }
}

/// `cases.toml`.
#[derive(Deserialize)]
struct Matrix {
    /// Named partial scenes.
    scene: BTreeMap<String, Part>,
    hostile: Vec<Case>,
    thesis: Vec<Case>,
}

/// All cases. `steps`: sub-steps of each hostile case; the thesis's variants have their own. `scale`: factor of the cells of the thesis's
/// scene.
///
/// # Errors
/// [`Error::Input`] where `cases.toml` is not valid TOML.
pub fn cases(steps: u64, scale: f64) -> Result<Vec<Case>, Error> {
    let Matrix { scene, hostile, thesis } = from_toml("cases.toml of bench stability", CASES)?;
    let hostile = hostile.into_iter().map(|case| {
        let names = ["every"].into_iter().chain(case.parts.iter().map(String::as_str));
        let parts = names.filter_map(|name| scene.get(name));
        let mut text = Part::new();
        parts.chain([&case.own]).for_each(|part| merge(&mut text, part));
        Case { text: text.to_string(), steps, ..case }
    });
    let thesis = thesis.into_iter().map(|case| {
        let scale = Some(scale * case.scale.unwrap_or(1.0));
        Case { text: THESIS.to_owned(), steps: THESIS_STEPS, scale, ..case }
    });
    Ok(hostile.chain(thesis).collect())
}
