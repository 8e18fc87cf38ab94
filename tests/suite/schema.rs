//! The JSON schema of scene files says what the reader says: the same keys, types and ranges.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use cutwater::scene::Scene;
use cutwater::scene::schema::{EXEMPLARS, schema};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::output::python_with;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What an independent validator holds against each scene; nothing, with the reason printed, where there is none.
fn validate(schema: &Value, scenes: &[Value]) -> Option<Vec<Vec<String>>> {
    let python = python_with("jsonschema_rs")?;
    let mut child = Command::new(python)
        .arg(root().join("tests/readers/validate.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let given = json!({ "schema": schema, "instances": scenes });
    child.stdin.take().unwrap().write_all(given.to_string().as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let verdicts: Vec<Vec<String>> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(verdicts.len(), scenes.len());
    Some(verdicts)
}

/// A TOML text as JSON.
fn json_of(text: &str) -> Value {
    let table: toml::Table = toml::from_str(text).unwrap();
    serde_json::to_value(table).unwrap()
}

/// A folder with the mesh files that the exemplars name: the reader of scenes only hashes them.
fn with_meshes() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["liquid.obj", "obstacle.stl", "solid.vtu", "solid.ply"] {
        fs::write(folder.path().join(name), "").unwrap();
    }
    folder
}

/// What the reader says of a scene.
fn read(folder: &TempDir, scene: &Value) -> Result<(), String> {
    let text = toml::to_string(scene).unwrap();
    let read = Scene::parse(&folder.path().join("scene.toml"), &text, &[], 1.0);
    read.map(|_| ()).map_err(|error| error.to_string())
}

/// A key of the schema: where its value stands in the first exemplar that has one, as a JSON pointer, and the schema of that value.
struct Key {
    exemplar: usize,
    pointer: String,
    schema: Value,
}

/// All keys of tables below a schema, with their values in the exemplars.
fn keys(schema: &Value) -> Vec<Key> {
    let mut keys: Vec<Key> = Vec::new();
    for (exemplar, text) in EXEMPLARS.iter().enumerate() {
        walk(&json_of(text), schema, "", &mut |pointer, schema| {
            let plain = |pointer: &str| {
                pointer.split('/').filter(|part| part.parse::<usize>().is_err()).collect::<Vec<_>>().join("/")
            };
            if keys.iter().all(|key| plain(&key.pointer) != plain(pointer)) {
                keys.push(Key { exemplar, pointer: pointer.to_owned(), schema: schema.clone() });
            }
        });
    }
    keys
}

fn walk(value: &Value, schema: &Value, pointer: &str, see: &mut dyn FnMut(&str, &Value)) {
    match value {
        Value::Object(entries) => {
            for (name, value) in entries {
                let schema = &schema["properties"][name];
                let pointer = format!("{pointer}/{name}");
                see(&pointer, schema);
                walk(value, schema, &pointer, see);
            }
        }
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                walk(item, &schema["items"], &format!("{pointer}/{index}"), see);
            }
        }
        _ => {}
    }
}

/// Every property of every table of a schema: its path and schema.
fn properties(schema: &Value, path: &str, see: &mut dyn FnMut(&str, &Value)) {
    if let Some(all) = schema["properties"].as_object() {
        for (name, property) in all {
            let path = format!("{path}.{name}");
            see(&path, property);
            properties(property, &path, see);
        }
    }
    if schema.get("items").is_some() {
        properties(&schema["items"], path, see);
    }
}

#[test]
fn every_key_has_a_type_and_words() {
    let schema = schema().unwrap();
    let mut n = 0;
    properties(&schema, "", &mut |path, property| {
        n += 1;
        let typed = ["type", "anyOf"].iter().any(|word| property.get(word).is_some());
        assert!(typed, "no exemplar in src/scene/exemplars shows {path}, so nobody asked what it is");
        // Tables and lists of them speak through their keys, words for themselves.
        let keys = [property, &property["items"]];
        let table = keys.iter().any(|of| of.get("properties").is_some());
        let speaks = table || property.get("enum").is_some();
        let described = property["description"].as_str().is_some_and(|words| !words.is_empty());
        assert!(speaks || described, "{path} is described neither by docs/scene.md nor by what the reader calls it");
    });
    assert!(n > 150, "{n} keys");
    // One of each kind, as it should come out.
    let at = |pointer: &str| schema.pointer(pointer).unwrap().clone();
    assert_eq!(at("/required"), json!(["domain", "time"]));
    assert_eq!(at("/properties/domain/required"), json!(["cells", "size"]));
    let gravity = at("/properties/domain/properties/gravity");
    assert_eq!(gravity["default"], json!([0, -9.81, 0]));
    assert_eq!((&gravity["minItems"], &gravity["items"]["type"]), (&json!(3), &json!("number")));
    let density = at("/properties/liquid/properties/density");
    assert_eq!(density["description"], "kg/m^3; 1e-6 to 1e6; default: 1000");
    assert_eq!((&density["minimum"], &density["maximum"]), (&json!(1e-6), &json!(1e6)));
    let poisson = at("/properties/solid/items/properties/poisson");
    assert_eq!((&poisson["exclusiveMinimum"], &poisson["exclusiveMaximum"]), (&json!(-1.0), &json!(0.5)));
    assert_eq!(at("/properties/liquid/properties/surface/enum"), json!(["level", "markers", "fixed"]));
    assert_eq!(at("/properties/liquid/properties/separation/enum"), json!(["none", "walls", "from_air"]));
    assert_eq!(at("/properties/output/properties/every/minimum"), json!(1));
    assert_eq!(at("/properties/solid/items/required"), json!(["density", "mesh", "name", "poisson", "young"]));
    let shapes = at("/properties/obstacle/items/oneOf");
    assert!(shapes.as_array().unwrap().contains(&json!({ "required": ["mesh"] })), "{shapes}");
    let solid = at("/properties/probe/items/properties/node/properties/solid");
    assert!(solid.get("enum").is_none(), "names are the scene's own: {solid}");
}

#[test]
fn every_scene_is_valid() {
    let entries = fs::read_dir(root().join("scenes")).unwrap();
    let mut scenes: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    scenes.retain(|path| path.extension().is_some_and(|end| end == "toml"));
    assert!(scenes.len() > 10);
    let read = |path: &PathBuf| fs::read_to_string(path).unwrap();
    let mut texts: Vec<String> = scenes.iter().map(read).collect();
    texts.extend(EXEMPLARS.map(str::to_owned));
    let instances: Vec<Value> = texts.iter().map(|text| json_of(text)).collect();
    let Some(verdicts) = validate(&schema().unwrap(), &instances) else {
        return;
    };
    for (text, errors) in texts.iter().zip(verdicts) {
        assert!(errors.is_empty(), "{errors:?} in\n{text}");
    }
}

/// A scene that one of both should refuse.
struct Case {
    what: String,
    scene: Value,
    /// Whether both must.
    both: bool,
}

/// What the schema refuses the reader must refuse, with the line and the cure; and both what is wrong for certain. Gives how many scenes
/// the schema refused.
fn agree(schema: &Value, cases: &[Case]) -> usize {
    let folder = with_meshes();
    let scenes: Vec<Value> = cases.iter().map(|case| case.scene.clone()).collect();
    let reads: Vec<_> = scenes.iter().map(|scene| read(&folder, scene)).collect();
    for (case, reads) in cases.iter().zip(&reads) {
        let told = reads.as_ref().err();
        assert!(told.is_some() || !case.both, "{}: the reader accepts", case.what);
        if let Some(message) = told {
            assert!(message.contains("cure: ") && message.contains("scene.toml:"), "{}: {message}", case.what);
        }
    }
    let Some(verdicts) = validate(schema, &scenes) else {
        return cases.len();
    };
    for ((case, reads), errors) in cases.iter().zip(&reads).zip(&verdicts) {
        let valid = errors.is_empty();
        assert!(valid || reads.is_err(), "{}: only the schema refuses: {errors:?}", case.what);
        assert!(!valid || !case.both, "{}: the schema accepts", case.what);
    }
    verdicts.iter().filter(|errors| !errors.is_empty()).count()
}

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    }
}

/// Values of every type in the place of every key.
#[test]
fn schema_and_reader_refuse_the_same_types() {
    let (schema, folder) = (schema().unwrap(), with_meshes());
    let values = [
        json!(true),
        json!(-1),
        json!(0.5),
        json!("word"),
        json!(""),
        json!([]),
        json!([1, 2, 3]),
        json!(["a", "b", "c"]),
        json!([[1, 2, 3]]),
        json!([{ "zzz": 1 }]),
        json!({}),
        json!({ "zzz": 1 }),
    ];
    let scenes = EXEMPLARS.map(json_of);
    for scene in &scenes {
        assert_eq!(read(&folder, scene), Ok(()));
    }
    let mut cases = Vec::new();
    for key in keys(&schema) {
        for value in &values {
            let mut scene = scenes[key.exemplar].clone();
            *scene.pointer_mut(&key.pointer).unwrap() = value.clone();
            let of_type = match &key.schema["type"] {
                Value::Null => value.is_number() || value.is_array(),
                kind => *kind == kind_of(value) || *kind == "integer" && value.is_number(),
            };
            cases.push(Case { what: format!("{} = {value}", key.pointer), scene, both: !of_type });
        }
    }
    assert!(cases.len() > 1500, "{}", cases.len());
    let refused = agree(&schema, &cases);
    assert!(refused > 1000, "{refused}");
}

/// Just beyond each end of each range.
#[test]
fn schema_and_reader_refuse_the_same_numbers() {
    let schema = schema().unwrap();
    let mut cases = Vec::new();
    for key in keys(&schema) {
        let list = key.schema.get("items").filter(|items| items["type"] == "integer");
        let range = list.unwrap_or(&key.schema);
        let whole = range["type"] == "integer";
        let beyond = |end: f64, sign: f64| match whole {
            true => json!((end + sign) as i64),
            false => json!(end + sign * (1e-9 * end.abs()).max(1e-300)),
        };
        let ends = [
            range["minimum"].as_f64().map(|end| beyond(end, -1.0)),
            range["maximum"].as_f64().filter(|end| *end < 1e15).map(|end| beyond(end, 1.0)),
            range.get("exclusiveMinimum").cloned(),
            range.get("exclusiveMaximum").cloned(),
        ];
        for value in ends.into_iter().flatten() {
            let mut scene = json_of(EXEMPLARS[key.exemplar]);
            let place = scene.pointer_mut(&key.pointer).unwrap();
            match place.as_array_mut() {
                Some(items) => items[0] = value.clone(),
                None => *place = value.clone(),
            }
            cases.push(Case { what: format!("{} = {value}", key.pointer), scene, both: true });
        }
    }
    assert!(cases.len() > 50, "{}", cases.len());
    agree(&schema, &cases);
}

/// A key that no table has, in every table; and every required key left out.
#[test]
fn schema_and_reader_want_the_same_keys() {
    let schema = schema().unwrap();
    let mut cases = Vec::new();
    for (number, text) in EXEMPLARS.iter().enumerate() {
        let scene = json_of(text);
        let mut tables = vec![(String::new(), schema.clone())];
        walk(&scene, &schema, "", &mut |pointer, schema| {
            let value = scene.pointer(pointer).unwrap();
            if value.is_object() {
                tables.push((pointer.to_owned(), schema.clone()));
            }
            for index in 0..value.as_array().map_or(0, Vec::len) {
                if value[index].is_object() {
                    tables.push((format!("{pointer}/{index}"), schema["items"].clone()));
                }
            }
        });
        for (pointer, schema) in tables {
            let mut with = scene.clone();
            with.pointer_mut(&pointer).unwrap()["zzz"] = json!(1);
            cases.push(Case { what: format!("{number}{pointer} with a key that it has not"), scene: with, both: true });
            for name in schema["required"].as_array().into_iter().flatten() {
                let mut without = scene.clone();
                let table = without.pointer_mut(&pointer).unwrap().as_object_mut().unwrap();
                table.remove(name.as_str().unwrap()).unwrap();
                cases.push(Case { what: format!("{number}{pointer} without {name}"), scene: without, both: true });
            }
        }
    }
    assert!(cases.len() > 150, "{}", cases.len());
    agree(&schema, &cases);
}

#[test]
fn the_command_prints_it() {
    let folder = crate::cli::folder("");
    let said = crate::cli::says(&folder, "schema");
    assert_eq!(crate::common::json(said), schema().unwrap());
}
