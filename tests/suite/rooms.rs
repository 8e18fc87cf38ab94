//! The rooms of `src/` use each other downwards only, each large library stays in its room, stages share
//! their nouns, and no shader lies unused.
//!
//! The sources are read as tokens, so comments, doc links and strings count for nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use cutwater::effects::Effects;
use cutwater::scene::Scene;
use cutwater::step::{Runner, SCHEDULE, Stage};
use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// Lower ones first. A room may use the rooms of all tiers below its own, and what [`PEERS`] adds.
const TIERS: &[&[&str]] = &[
    &["error"],
    &["grid"],
    &["scene", "state"],
    &["effects"],
    &["gpu", "geometry", "elastic", "linalg", "step"],
    &["fields"],
    &["output", "stages", "solver", "reference"],
    &["sim"],
    &["measure"],
    &["cli"],
];

/// `(room, what it may use of its own tier)`.
const PEERS: &[(&str, &str)] = &[
    // The stages fill the solver's system and read its answer.
    ("stages", "solver"),
    // The elements stand on the meshes that geometry makes.
    ("elastic", "geometry"),
];

/// `(room, all that it may use)`, where that is less than all lower tiers.
const ONLY: &[(&str, &[&str])] = &[
    // The GPU layer knows no physics.
    ("gpu", &["error"]),
    // A twin that shared code with what it judges would judge nothing.
    ("reference", &["error", "grid", "scene", "state", "effects", "geometry", "elastic", "linalg", "step"]),
];

/// `(crate, the only room that names it)`.
const HOMES: &[(&str, &str)] = &[
    ("wgpu", "gpu"),
    ("naga", "gpu"),
    ("faer", "linalg"),
    ("parry3d_f64", "geometry"),
    ("spade", "geometry"),
    ("toml", "scene"),
    ("vtkio", "output"),
    ("npyz", "output"),
    ("zip", "output"),
    ("splashsurf_lib", "output"),
    ("png", "output"),
    ("noto_sans_mono_bitmap", "output"),
    ("maud", "output"),
    ("clap", "cli"),
    ("ctrlc", "cli"),
    ("signal_hook", "cli"),
    ("nix", "cli"),
    ("rustix", "gpu"),
    ("sysinfo", "sim"),
    ("indicatif", "cli"),
];

/// What `crate::NAME` means where NAME is not a room.
const ROOT_NAMES: &[(&str, &str)] = &[("Error", "error"), ("arrays", "fields"), ("wgsl", "gpu")];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All files below a folder of the repository with one of these extensions, sorted.
fn files(folder: &str, extensions: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| extensions.iter().any(|known| end == *known)) {
                found.push(path);
            }
        }
    }
    assert!(!found.is_empty(), "no {extensions:?} in {folder}");
    found.sort();
    found
}

/// Path below the repository's root, with `/`.
fn name(path: &Path) -> String {
    let parts = path.strip_prefix(root()).unwrap().components();
    parts.map(|part| part.as_os_str().to_str().unwrap()).collect::<Vec<_>>().join("/")
}

/// One source file below `src/`.
struct File {
    name: String,
    /// The modules it is, from the crate's root: `["solver", "pcg"]`.
    modules: Vec<String>,
    tokens: Vec<TokenTree>,
}

impl File {
    fn all() -> Vec<File> {
        let read = |path: PathBuf| {
            let name = name(&path);
            let text = fs::read_to_string(&path).unwrap();
            let tokens = text.parse::<TokenStream>().unwrap_or_else(|error| panic!("{name}: {error}"));
            let modules = name.trim_start_matches("src/").trim_end_matches(".rs").split('/');
            let modules = modules.filter(|part| !["mod", "lib"].contains(part)).map(str::to_owned).collect();
            File { name, modules, tokens: tokens.into_iter().collect() }
        };
        files("src", &["rs"]).into_iter().map(read).collect()
    }

    /// The room; empty for the crate's root.
    fn room(&self) -> &str {
        match self.modules.first().map(String::as_str) {
            None | Some("main") => "",
            Some(room) => room,
        }
    }

    /// Calls `see(tokens, index, depth)` for every token, `depth` modules below the crate's root.
    fn walk(&self, see: &mut dyn FnMut(&[TokenTree], usize, usize)) {
        walk(&self.tokens, self.modules.len(), see);
    }
}

fn walk(tokens: &[TokenTree], depth: usize, see: &mut dyn FnMut(&[TokenTree], usize, usize)) {
    for index in 0..tokens.len() {
        see(tokens, index, depth);
        if let TokenTree::Group(group) = &tokens[index] {
            let module = index >= 2 && is_ident(&tokens[index - 2], "mod") && group.delimiter() == Delimiter::Brace;
            let inner: Vec<TokenTree> = group.stream().into_iter().collect();
            walk(&inner, depth + usize::from(module), see);
        }
    }
}

fn ident(token: Option<&TokenTree>) -> Option<String> {
    match token {
        Some(TokenTree::Ident(ident)) => Some(ident.to_string()),
        _ => None,
    }
}

fn is_ident(token: &TokenTree, name: &str) -> bool {
    matches!(token, TokenTree::Ident(ident) if ident == name)
}

fn is_punct(token: Option<&TokenTree>, character: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == character)
}

fn is_path_separator(tokens: &[TokenTree], index: usize) -> bool {
    is_punct(tokens.get(index), ':') && is_punct(tokens.get(index + 1), ':')
}

/// First names of `NAME::..` or `{NAME::.., NAME}` at an index.
fn first_names(tokens: &[TokenTree], index: usize) -> Vec<String> {
    match tokens.get(index) {
        Some(TokenTree::Group(group)) => {
            let inner: Vec<TokenTree> = group.stream().into_iter().collect();
            let starts = (0..inner.len()).filter(|&at| at == 0 || is_punct(inner.get(at - 1), ','));
            starts.flat_map(|at| first_names(&inner, at)).collect()
        }
        token => ident(token).into_iter().collect(),
    }
}

/// Names that a file takes from the crate's root, with how they are written.
fn root_names(file: &File) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    file.walk(&mut |tokens, index, depth| {
        let starts_path = index < 2 || !is_path_separator(tokens, index - 2);
        if !starts_path {
            return;
        }
        let mut next = index;
        if is_ident(&tokens[index], "crate") || (file.room() == "cli" && is_ident(&tokens[index], "cutwater")) {
            next += 1;
        } else {
            let mut up = 0;
            while ident(tokens.get(next)).is_some_and(|word| word == "super") {
                up += 1;
                next += if is_path_separator(tokens, next + 1) { 3 } else { 1 };
            }
            if up == 0 || up < depth {
                return;
            }
            next -= 2;
        }
        if is_path_separator(tokens, next) {
            found.extend(first_names(tokens, next + 2));
        }
    });
    found
}

fn tier(room: &str) -> Option<usize> {
    TIERS.iter().position(|tier| tier.contains(&room))
}

fn may_use(room: &str, used: &str) -> bool {
    if let Some((_, only)) = ONLY.iter().find(|(name, _)| *name == room) {
        return only.contains(&used);
    }
    tier(used) < tier(room) || PEERS.contains(&(room, used))
}

#[test]
fn rooms_use_each_other_downwards_only() {
    let mut breaches = Vec::new();
    let mut seen: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for file in File::all().iter().filter(|file| !file.room().is_empty()) {
        let room = file.room();
        assert!(tier(room).is_some(), "{}: no such room; TIERS says where it belongs", file.name);
        for found in root_names(file) {
            let used = ROOT_NAMES.iter().find(|(name, _)| *name == found).map_or(found.as_str(), |(_, room)| room);
            if tier(used).is_none() {
                breaches.push(format!("{}: crate::{found} is neither a room nor known to ROOT_NAMES", file.name));
            } else if used != room {
                seen.entry(room.to_owned()).or_default().insert(used.to_owned());
                if !may_use(room, used) {
                    breaches.push(format!("{}: {room} uses {used}", file.name));
                }
            }
        }
    }
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
    // The reading itself works: these are how the program hangs together.
    for (room, used) in [("solver", "gpu"), ("reference", "linalg"), ("geometry", "grid"), ("stages", "gpu")] {
        assert!(seen.get(room).is_some_and(|all| all.contains(used)), "{room} was not seen to use {used}: {seen:?}");
    }
}

#[test]
fn large_libraries_stay_in_their_rooms() {
    let mut breaches = Vec::new();
    let mut seen = BTreeSet::new();
    for file in File::all() {
        file.walk(&mut |tokens, index, _| {
            for (library, home) in HOMES {
                if is_ident(&tokens[index], library) && is_path_separator(tokens, index + 1) {
                    seen.insert(*library);
                    if file.room() != *home {
                        breaches.push(format!("{}: {library} belongs in {home} only", file.name));
                    }
                }
            }
        });
    }
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
    for library in ["wgpu", "naga", "faer", "parry3d_f64"] {
        assert!(seen.contains(library), "{library} was not seen anywhere");
    }
}

#[test]
fn the_root_has_no_logic() {
    for file in File::all().iter().filter(|file| file.name == "src/lib.rs") {
        file.walk(&mut |tokens, index, _| {
            for word in ["fn", "struct", "enum", "impl", "const", "static"] {
                assert!(!is_ident(&tokens[index], word), "{}: `{word}` belongs in a room", file.name);
            }
        });
    }
}

/// Largest number of files besides `effects.rs` and the schedule that query one effect, and that of the effects that choose between
/// whole families of stages.
const FILES_OF_AN_EFFECT: usize = 6;
const FILES_OF_A_FAMILY: usize = 12;

/// An effect moves in at few places: its name is queried in few files. All else derives from the tables of effects, stages and arrays.
#[test]
fn an_effect_is_queried_in_few_files() {
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [4, 4, 4]\n[time]\nduration = 1\n[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.5, 1] }\n";
    let scene = Scene::parse(Path::new("pool.toml"), text, &[], 1.0).unwrap();
    let names: Vec<&str> = Effects::of(&scene).explained(&scene).into_iter().map(|effect| effect.name).collect();
    let mut found: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for file in File::all().into_iter().filter(|file| !["src/effects.rs", "src/step.rs"].contains(&&*file.name)) {
        file.walk(&mut |tokens, index, _| {
            let owner = index.checked_sub(2).and_then(|owner| ident(tokens.get(owner)));
            if is_punct(index.checked_sub(1).and_then(|dot| tokens.get(dot)), '.')
                && owner.is_some_and(|owner| owner == "effects")
                && let Some(name) = names.iter().find(|name| is_ident(&tokens[index], name))
            {
                found.entry(name).or_default().insert(file.name.clone());
            }
        });
    }
    for (name, files) in &found {
        let most = if ["liquid", "markers", "level"].contains(name) { FILES_OF_A_FAMILY } else { FILES_OF_AN_EFFECT };
        assert!(files.len() <= most, "{name} is queried in {} files, {most} may: {files:?}", files.len());
    }
    assert!(found["separation"].len() > 1, "{found:?}");
}

#[test]
fn stages_share_their_nouns() {
    for row in &SCHEDULE {
        // `clip` is geometry's, of both.
        if row.runner != Runner::Gpu && row.stage != Stage::Clip {
            let twin = format!("src/reference/{}.rs", row.name);
            assert!(root().join(&twin).exists(), "no {twin}");
        }
    }
    // What several stages use.
    let shared = ["mod", "band"];
    let parts = [
        ("ballistic", "move_solid"),
        ("cavities", "right_hand_side"),
        ("element_rotations", "solid_matrices"),
        ("level_exchange", "advect_level"),
        ("patch_pressure", "right_hand_side"),
        ("separation", "solve"),
    ];
    // Tests of several stages.
    let tests = [
        ("active_cells", "solver"),
        ("ballistic", "twin_move_solid"),
        ("bound_level", "twin_level_shape"),
        ("cavities", "cavities"),
        ("closed_components", "components"),
        ("excess", "twin_liquid_components"),
        ("filter_level", "twin_level_shape"),
        ("landing", "twin_level_markers"),
        ("level_exchange", "level_exchange"),
        ("marker_band", "twin_level_markers"),
        ("occupancy", "twin_level_shape"),
        ("patch_pressure", "twin_coupling"),
        ("redistance", "twin_level_shape"),
        ("spray", "twin_level_markers"),
        ("volume_shift", "twin_liquid_components"),
    ];
    for file in files("src/stages", &["rs"]) {
        let stem = file.file_stem().unwrap().to_str().unwrap();
        if !shared.contains(&stem) {
            let part = parts.iter().find(|(part, _)| *part == stem);
            let stage = part.map_or(stem, |(_, stage)| stage);
            assert!(SCHEDULE.iter().any(|row| row.name == stage), "the schedule has no stage {stage}");
            let test = tests.iter().find(|(stage, _)| *stage == stem);
            let test = test.map_or_else(|| format!("twin_{stem}"), |(_, test)| (*test).to_owned());
            let test = format!("tests/suite/{test}.rs");
            assert!(root().join(&test).exists(), "no {test}");
        }
    }
}

#[test]
fn every_shader_is_used() {
    let mut embedded = BTreeSet::new();
    for file in File::all() {
        file.walk(&mut |tokens, index, _| {
            if let (true, true, Some(TokenTree::Group(group))) =
                (is_ident(&tokens[index], "wgsl"), is_punct(tokens.get(index + 1), '!'), tokens.get(index + 2))
            {
                embedded.insert(group.stream().to_string().trim_matches('"').to_owned());
            }
        });
    }
    let shaders = files("shaders", &["wgsl"]);
    let stem = |path: &Path| name(path).trim_start_matches("shaders/").trim_end_matches(".wgsl").to_owned();
    let texts: Vec<String> = shaders.iter().map(|path| fs::read_to_string(path).unwrap()).collect();
    let imported: BTreeSet<&str> = texts
        .iter()
        .flat_map(|text| text.lines())
        .filter_map(|line| line.strip_prefix("#import "))
        .map(str::trim)
        .collect();
    for shader in shaders.iter().map(|path| stem(path)) {
        assert!(embedded.contains(&shader), "shaders/{shader}.wgsl: no wgsl!(\"{shader}\") in src");
        if let Some(module) = shader.strip_prefix("common/") {
            // `real`, `inner` and `obstacles` stand for the file of the variant.
            let endings = ["_f32", "_f64", "_still", "_moving"].into_iter();
            let module = endings.fold(module, |module, end| module.trim_end_matches(end));
            assert!(imported.contains(module), "shaders/{shader}.wgsl: nothing imports {module}");
        }
    }
}

/// `src` without the modules that only tests compile.
fn walk_shipped(file: &File, see: &mut dyn FnMut(&[TokenTree], usize)) {
    fn walk(tokens: &[TokenTree], see: &mut dyn FnMut(&[TokenTree], usize)) {
        let mut test_only = false;
        for (index, token) in tokens.iter().enumerate() {
            see(tokens, index);
            if let TokenTree::Group(group) = token {
                let text = group.stream().to_string();
                if group.delimiter() == Delimiter::Bracket && text.replace(' ', "") == "cfg(test)" {
                    test_only = true;
                } else if group.delimiter() == Delimiter::Brace && std::mem::take(&mut test_only) {
                    continue;
                }
                walk(&group.stream().into_iter().collect::<Vec<_>>(), see);
            }
        }
    }
    walk(&file.tokens, see);
}

#[test]
fn the_library_neither_prints_nor_unwraps() {
    for file in File::all() {
        walk_shipped(&file, &mut |tokens, index| {
            let method = index > 0 && is_punct(tokens.get(index - 1), '.');
            assert!(
                !(method && is_ident(&tokens[index], "unwrap")),
                "{}: .unwrap(): use expect with the invariant in words, or an Error",
                file.name
            );
            let printing = ["print", "println", "eprint", "eprintln"].iter().any(|word| is_ident(&tokens[index], word));
            assert!(
                !printing || !is_punct(tokens.get(index + 1), '!'),
                "{}: only the command line prints, with say! and warn!, which a closed pipe does not end",
                file.name
            );
        });
    }
}

/// A file that is written in place is half a file for a while, and on a full disk for ever. Tables of a run grow row by row.
#[test]
fn files_are_written_whole() {
    for file in File::all() {
        if ["src/output/atomic.rs", "src/output/tables.rs"].contains(&file.name.as_str()) {
            continue;
        }
        walk_shipped(&file, &mut |tokens, index| {
            let path = |of: &str, function: &str| {
                is_ident(&tokens[index], of)
                    && is_path_separator(tokens, index + 1)
                    && tokens.get(index + 3).is_some_and(|token| is_ident(token, function))
            };
            let in_place = [("fs", "write"), ("File", "create"), ("Writer", "from_path"), ("SVGBackend", "new")];
            assert!(
                !in_place.iter().any(|(of, function)| path(of, function)),
                "{}: use output::write_atomically",
                file.name
            );
        });
    }
}

#[test]
fn nothing_is_left_over() {
    // Put together here, so that this file does not hold them.
    let marks = ["TO-DO", "FIX-ME", "#[ign-ore", "XX-X", "/ho-me/", "/ro-ot/", "/Us-ers/", "/tm-p/", "/wo-rk/"];
    let marks = marks.map(|mark| mark.replace('-', ""));
    let mut all = ["Cargo.toml", "Makefile", "README.md", "ARCHITECTURE.md", "CHANGELOG.md"]
        .map(|file| root().join(file))
        .to_vec();
    // Not in the published package.
    if let Ok(scripts) = fs::read_dir(root().join(".ci")) {
        let paths = scripts.map(|entry| entry.unwrap().path());
        all.extend(paths.filter(|path| path.is_file()));
    }
    for (folder, extensions) in [
        ("src", &["rs"][..]),
        ("tests", &["rs", "py", "txt"]),
        ("shaders", &["wgsl"]),
        ("scenes", &["toml"]),
        ("docs", &["md"]),
    ] {
        all.extend(files(folder, extensions));
    }
    for path in all {
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", name(&path)));
        for (number, line) in text.lines().enumerate() {
            for mark in &marks {
                assert!(!line.contains(mark.as_str()), "{}:{}: {mark}: {line}", name(&path), number + 1);
            }
        }
    }
}
