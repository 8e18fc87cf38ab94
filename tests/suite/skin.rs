//! Skins of solids: render meshes carried by tetrahedra, as PLY and animated glTF, read back by independent readers; glTF as a source of surfaces.

use std::fs;
use std::path::Path;
use std::process::Command;

use cutwater::geometry::{self, Embedding, TetMesh};
use cutwater::output::skin::{SkinOptions, skins};
use glam::DVec3;
use serde_json::Value;

use crate::output::python_with;
use crate::output_solids::Case;

/// A cube of unit length in cm about the origin, with texture coordinates on one face only and a seam along its edges.
const CUBE: &str =
    "v -10 -10 -10\nv 10 -10 -10\nv 10 10 -10\nv -10 10 -10\nv -10 -10 10\nv 10 -10 10\nv 10 10 10\nv -10 10 10
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
f 1/1 4/2 3/3 2/4\nf 5/1 6/2 7/3 8/4\nf 1/1 2/2 6/3 5/4\nf 2/1 3/2 7/3 6/4\nf 3/1 4/2 8/3 7/4\nf 4/1 1/2 5/3 8/4\n";

/// The block of the scene, 20 cm wide and high and 30 cm deep, from the cube.
const SCENE: &str = "[domain]
size = [1, 0.5, 0.5]
cells = [16, 8, 8]
[time]
duration = 1
[[solid]]
name = 'block'
mesh = { surface = { file = 'cube.obj', units = 'cm', cell_size = 0.05 } }
placement = { at = [0.5, 0.25, 0.25] }
density = 1000
young = 1e6
poisson = 0.25
";

#[test]
fn points_move_with_their_tetrahedra() {
    // A cube of six tetrahedra about its diagonal.
    let corner = |number: u32| DVec3::new(f64::from(number & 1), f64::from(number >> 1 & 1), f64::from(number >> 2));
    let mesh = TetMesh {
        nodes: (0..8).map(corner).collect(),
        elements: vec![[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]],
    };
    let points: Vec<DVec3> = (0..200)
        .map(|number| DVec3::from([0.618, 0.324, 0.471].map(|step| 1.4 * (step * f64::from(number)).fract() - 0.2)))
        .collect();
    let embedding = Embedding::new(&mesh, &points);
    // Linear fields are reproduced, outside too, to the rounding of weights of order 1.
    let map = |x: DVec3| DVec3::new(x.y + 2.0 * x.x, x.z - 0.5 * x.y, 3.0 - x.x + x.z);
    let moved: Vec<DVec3> = mesh.nodes.iter().map(|&x| map(x)).collect();
    for (x, y) in points.iter().zip(embedding.at(&moved)) {
        assert!(map(*x).distance(y) < 1e-12, "{x} {y}");
    }
    // Inside, no weight is negative.
    for (x, weights) in points.iter().zip(&embedding.weights) {
        let inside = x.min_element() >= 0.0 && x.max_element() <= 1.0;
        let least = weights.iter().copied().fold(1.0, f64::min);
        assert_eq!(inside, least >= -1e-9, "{x} {weights:?}");
    }
    let outside = |x: DVec3| x.distance(x.clamp(DVec3::ZERO, DVec3::ONE));
    let farthest = points.iter().map(|&x| outside(x)).fold(0.0, f64::max);
    assert!((embedding.farthest - farthest).abs() < 1e-12);
}

/// What trimesh (PLY) and pygltflib-like decoding by numpy (glTF) find.
fn found(folder: &Path, script: &str) -> Option<Value> {
    let python = python_with("trimesh")?;
    let output = Command::new(python).current_dir(folder).args(["-c", script]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

/// Decodes a .glb by its specification alone.
const GLB: &str = "
import json, struct, numpy, sys
data = open(PATH, 'rb').read()
magic, version, length, n, kind = struct.unpack('<4sIII4s', data[:20])
assert (magic, version, length, kind) == (b'glTF', 2, len(data), b'JSON')
root = json.loads(data[20:20 + n])
m, kind = struct.unpack('<I4s', data[20 + n:28 + n])
assert kind == b'BIN\\0' and 28 + n + m == len(data)
binary = data[28 + n:]
def read(index):
    accessor = root['accessors'][index]
    view = root['bufferViews'][accessor['bufferView']]
    width = {'SCALAR': 1, 'VEC2': 2, 'VEC3': 3}[accessor['type']]
    kind = {5125: '<u4', 5126: '<f4'}[accessor['componentType']]
    values = numpy.frombuffer(binary, kind, width * accessor['count'], view['byteOffset']).reshape(-1, width)
    for bound, least in (('min', values.min(axis=0)), ('max', values.max(axis=0))):
        assert bound not in accessor or numpy.allclose(accessor[bound], least)
    return values.astype(float)
mesh = root['meshes'][0]
part = mesh['primitives'][0]
base = read(part['attributes']['POSITION'])
uv = read(part['attributes']['TEXCOORD_0']) if 'TEXCOORD_0' in part['attributes'] else numpy.zeros((0, 2))
targets = [read(target['POSITION']) for target in part.get('targets', [])]
sampler = root['animations'][0]['samplers'][0]
print(json.dumps({'name': mesh['name'], 'base': base.tolist(), 'uv': uv.tolist(), 'targets': [t.tolist() for t in targets],
    'triangles': read(part['indices']).ravel().tolist(), 'times': read(sampler['input']).ravel().tolist(),
    'weights': read(sampler['output']).ravel().tolist(), 'path': root['animations'][0]['channels'][0]['target']['path']}))
";

const PLY: &str = "
import json, trimesh
raw = trimesh.exchange.ply.load_ply(open(PATH, 'rb'))['metadata']['_ply_raw']
vertex = raw['vertex']['data']
names = [str(name) for name in vertex.dtype.names]
print(json.dumps({'names': names, 'columns': {name: vertex[name].reshape(-1).astype(float).tolist() for name in names}}))
";

/// Positions and texture coordinates of the corners of each triangle, by trimesh, which splits vertices as it needs.
const OBJ: &str = "
import json, trimesh
mesh = trimesh.load(PATH, process=False, maintain_order=True)
uv = mesh.visual.uv
print(json.dumps({'corners': mesh.vertices[mesh.faces].reshape(-1, 3).tolist(), 'uv': uv[mesh.faces].reshape(-1, 2).tolist(),
    'normals': mesh.vertex_normals[mesh.faces].reshape(-1, 3).tolist(), 'faces': len(mesh.faces)}))
";

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn vectors(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(numbers).collect()
}

#[test]
fn skins_keep_texture_and_follow_the_solid() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("cube.obj"), CUBE).unwrap();
    let mut case = Case::in_folder(folder.path(), SCENE);
    let run = folder.path().join("run");
    fs::create_dir(&run).unwrap();
    let mut manifest = case.manifest();
    manifest.progress.frames_written = vec![0, 12];
    manifest.write(&run).unwrap();
    let mut writer = case.writer(&run);
    case.write(&mut writer).unwrap();
    // A rigid rotation by a right angle about z through the centre, and a uniform velocity.
    let turned = |x: DVec3| DVec3::new(0.5 - (x.y - 0.25), 0.25 + (x.x - 0.5), x.z);
    case.displace(0, |x| turned(x) - x);
    for velocity in &mut case.state.node_velocity {
        *velocity = [0.5, -1.0, 2.0];
    }
    case.state.frame = 12;
    case.state.time = 0.5;
    case.write(&mut writer).unwrap();

    let meshes = vec![("block".to_owned(), folder.path().join("cube.obj"))];
    let reports = skins(&run, &SkinOptions { meshes, obj: true }, &mut |_, _| {}).unwrap();
    // The file uses 20 distinct pairs of position and texture vertex.
    let report = &reports[0];
    assert_eq!((report.vertices, report.triangles, report.frames), (20, 12, 2));

    let frames = run.join("frames");
    let Some(ply) = found(&frames, &PLY.replace("PATH", "'blocks_block_000012.ply'")) else {
        return;
    };
    assert_eq!(ply["names"], serde_json::json!(["x", "y", "z", "nx", "ny", "nz", "vx", "vy", "vz", "s", "t"]));
    let column = |name: &str| numbers(&ply["columns"][name]);
    for (name, expected) in [("vx", 0.5), ("vy", -1.0), ("vz", 2.0)] {
        // Weights sum to 1 to the rounding of f32.
        assert!(column(name).iter().all(|v| (v - expected).abs() < 1e-5), "{name}");
    }
    let glb = found(&frames, &GLB.replace("PATH", "'blocks_block.glb'")).unwrap();
    assert_eq!(glb["name"], "block");
    assert_eq!(glb["path"], "weights");
    assert_eq!(numbers(&glb["times"]), [0.0, 0.5]);
    assert_eq!(numbers(&glb["weights"]), [0.0, 1.0]);
    let (base, target) = (vectors(&glb["base"]), vectors(&glb["targets"][0]));
    let (x, y, z, s, t) = (column("x"), column("y"), column("z"), column("s"), column("t"));
    for vertex in 0..20 {
        // Corners of the cube at rest, then turned; f32 positions of up to 1 m, and weights beyond 1 outside the tetrahedra.
        let rest = DVec3::from_slice(&base[vertex]);
        let from_centre = (rest - DVec3::new(0.5, 0.25, 0.25)).abs();
        assert!((from_centre - 0.1).abs().max_element() < 1e-6, "{rest}");
        let now = DVec3::new(x[vertex], y[vertex], z[vertex]);
        assert!(now.distance(turned(rest)) < 2e-6, "{now}");
        assert!((rest + DVec3::from_slice(&target[vertex])).distance(now) < 1e-6);
        let uv = &vectors(&glb["uv"])[vertex];
        assert_eq!([uv[0], 1.0 - uv[1]], [s[vertex], t[vertex]]);
    }

    // The same as OBJ; here triangles are counter-clockwise seen from outside.
    let obj = found(&frames, &OBJ.replace("PATH", "'blocks_block_000012.obj'")).unwrap();
    assert_eq!(obj["faces"], 12);
    let corners = numbers(&glb["triangles"]).into_iter().map(|vertex| vertex as usize);
    let of_obj = vectors(&obj["corners"]).into_iter().zip(vectors(&obj["uv"])).zip(vectors(&obj["normals"]));
    for (vertex, ((at, uv), normal)) in corners.zip(of_obj) {
        // The text reads back as the f32 of the PLY file.
        let single = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<f32>>();
        assert_eq!(single(&at), single(&[x[vertex], y[vertex], z[vertex]]));
        assert_eq!(single(&uv), single(&[s[vertex], t[vertex]]));
        let out = DVec3::from_slice(&at) - DVec3::new(0.5, 0.25, 0.25);
        assert!(DVec3::from_slice(&normal).dot(out) > 0.0, "{normal:?} at {at:?}");
    }

    // The animated file is itself a mesh that can be read: the cube of the first frame.
    let cube = geometry::read_mesh(&frames.join("blocks_block.glb")).unwrap();
    assert_eq!((cube.vertices.len(), cube.triangles.len()), (8, 12));
    assert!((cube.volume() - 8e-3).abs() < 1e-7);

    // Without a file: the boundary of the tetrahedra, closed, with its volume.
    skins(&run, &SkinOptions::default(), &mut |_, _| {}).unwrap();
    let boundary = geometry::read_mesh(&frames.join("blocks_block_000000.ply")).unwrap();
    let volume: f64 = case.solids.volume.iter().sum();
    assert!((boundary.volume() / volume - 1.0).abs() < 1e-5);
}

#[test]
fn wrong_skins_are_refused_with_their_cure() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("cube.obj"), CUBE).unwrap();
    let case = Case::in_folder(folder.path(), SCENE);
    let run = folder.path().join("run");
    fs::create_dir(&run).unwrap();
    let mut manifest = case.manifest();
    manifest.progress.frames_written = vec![0];
    manifest.write(&run).unwrap();
    case.write(&mut case.writer(&run)).unwrap();
    let cube = folder.path().join("cube.obj");
    let far = folder.path().join("far.obj");
    // In mm, where the solid's file is in cm.
    fs::write(&far, CUBE.replace("10", "100")).unwrap();
    for (solid, file, expected) in [
        ("ball", &cube, "no solid \"ball\""),
        ("block", &far, "units and axes"),
        ("block", &folder.path().join("none.obj"), "none.obj"),
    ] {
        let options = SkinOptions { meshes: vec![(solid.to_owned(), file.clone())], obj: false };
        let error = skins(&run, &options, &mut |_, _| {}).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// A triangle mesh as .gltf with its buffer inside; `change` edits the text.
fn gltf(change: impl Fn(String) -> String) -> Vec<u8> {
    // A tetrahedron (0, x, y, z), outwards, mirrored by its node and moved by 1 along x.
    let mut buffer = Vec::new();
    for x in [[0.0_f32; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
        buffer.extend(x.into_iter().flat_map(f32::to_le_bytes));
    }
    for corner in [0_u16, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3] {
        buffer.extend(corner.to_le_bytes());
    }
    use base64::Engine;
    let data = base64::engine::general_purpose::STANDARD.encode(&buffer);
    let text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"translation":[1,0,0],"children":[1]}},{{"scale":[-1,1,1],"mesh":0}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],"buffers":[{{"byteLength":72,"uri":"data:application/octet-stream;base64,{data}"}}],
"bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":24}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}},{{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}}]}}"#
    );
    change(text).into_bytes()
}

#[test]
fn gltf_surfaces_are_read_with_their_nodes() {
    let file = Path::new("mesh.gltf");
    let surface = geometry::parse_mesh(gltf(|text| text), file).unwrap();
    assert_eq!(surface.triangles.len(), 4);
    // Outwards although mirrored: the volume is positive.
    assert!((surface.volume() - 1.0 / 6.0).abs() < 1e-12);
    assert_eq!(surface.bounds(), [DVec3::ZERO, DVec3::ONE]);
}

#[test]
fn broken_gltf_is_refused() {
    let file = Path::new("mesh.gltf");
    for (from, to, expected) in [
        ("data:application/octet-stream;base64,", "mesh.bin?", "another file"),
        ("\"byteLength\":48", "\"byteLength\":47", "outside its buffer"),
        ("\"count\":4", "\"count\":5", "outside its buffer"),
        ("\"count\":12", "\"count\":11", "triangles"),
        ("\"byteLength\":72", "\"byteLength\":73", "incomplete"),
        ("\"count\":4,\"type\":\"VEC3\"", "\"count\":3,\"type\":\"VEC3\"", "triangles"),
        ("\"mesh\":0}", "\"mesh\":0,\"children\":[0]}", "two parents"),
        ("\"indices\":1", "\"indices\":1,\"mode\":5", "strips"),
        ("{\"asset\"", "{\"aset\"", "no glTF"),
    ] {
        let bytes = gltf(|text| {
            assert!(text.contains(from), "{from}");
            text.replacen(from, to, 1)
        });
        let error = geometry::parse_mesh(bytes, file).expect_err(to);
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{to}: {error}");
    }
}

#[test]
fn changed_gltf_is_read_or_refused() {
    let sound = gltf(|text| text);
    // A linear congruential generator (Knuth's MMIX); fixed, so that a failure repeats.
    let mut state = 1_u64;
    let mut random = move |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    let words = ["0", "-1", "4294967295", "18446744073709551615", "1e308", "null", "[]", "{}", "\"\"", ","];
    for _ in 0..3000 {
        let mut bytes = sound.clone();
        for _ in 0..=random(2) {
            let at = random(bytes.len());
            let end = (at + random(4)).min(bytes.len());
            bytes.splice(at..end, words[random(words.len())].bytes());
        }
        // Neither panics nor hangs.
        let _ = geometry::parse_mesh(bytes, Path::new("mesh.gltf"));
    }
}
