//! Surfaces as other programs write them: dialects of OBJ, STL and PLY, concave polygons, several bodies in one file; and surfaces that bound no
//! solid. Sizes are those of the bodies by hand.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use cutwater::geometry::{self, Surface, TetMesh, parse_mesh, parse_tets, read_mesh, read_tets};
use cutwater::output::write_mesh;
use cutwater::scene::Scene;
use glam::{DMat3, DVec3};
use serde_json::Value;

use crate::output::python_with;

/// Corner numbers of the sides of a box, whose corners count x first.
const SIDES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// A pillar of 0.2 x 0.6 x 0.2 m.
fn pillar() -> Surface {
    Surface::cuboid(DVec3::new(0.4, 0.0, 0.4), DVec3::splat(0.6))
}

/// The surface in a file of this name, or the error as text.
fn read(name: &str, bytes: impl AsRef<[u8]>) -> Result<Surface, String> {
    parse_mesh(bytes.as_ref().to_vec(), Path::new(name)).map_err(|error| {
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.contains("\n  cure: "), "{text}");
        text
    })
}

/// Asserts that a file holds the pillar.
fn assert_pillar(name: &str, bytes: impl AsRef<[u8]>) {
    let surface = read(name, bytes).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(surface.vertices.len(), 8, "{name}");
    assert_eq!(surface.triangles.len(), 12, "{name}");
    // Coordinates of single precision are off by 3e-8.
    assert!((surface.volume() - 0.024).abs() < 2e-8, "{name}: {}", surface.volume());
    let [low, high] = surface.bounds();
    let expected = pillar().bounds();
    assert!(low.distance(expected[0]) + high.distance(expected[1]) < 1e-7, "{name}");
}

fn assert_refused(name: &str, bytes: impl AsRef<[u8]>, words: &[&str]) {
    let error = read(name, bytes).expect_err(name);
    for word in words {
        assert!(error.contains(word), "{name}: {word} in: {error}");
    }
}

// STL

fn facets(surface: &Surface, normal: &str) -> String {
    let facet = |number| {
        let vertices = surface.corners(number).map(|x| format!("   vertex {} {} {}\n", x.x, x.y, x.z));
        format!(" facet normal {normal}\n  outer loop\n{}  endloop\n endfacet\n", vertices.concat())
    };
    (0..surface.triangles.len()).map(facet).collect()
}

fn binary_stl(surface: &Surface, header: &[u8]) -> Vec<u8> {
    let mut bytes = header.to_vec();
    bytes.resize(80, b' ');
    bytes.extend((surface.triangles.len() as u32).to_le_bytes());
    for number in 0..surface.triangles.len() {
        bytes.extend([0; 12]);
        for x in surface.corners(number) {
            bytes.extend(x.to_array().into_iter().flat_map(|x| (x as f32).to_le_bytes()));
        }
        bytes.extend([0, 0]);
    }
    bytes
}

#[test]
fn text_stl_of_many_programs_is_read() {
    let body = facets(&pillar(), "0 0 0");
    let whole = |head: &str| format!("{head}{body}endsolid\n");
    for (name, text) in [
        ("named", whole("solid pillar\n")),
        ("nameless", whole("solid\n")),
        ("indented", whole("\n  solid pillar\n")),
        ("tab", whole("solid\tpillar\n")),
        ("mark", whole("\u{feff}solid pillar\n")),
        ("keywords in the name", whole("solid outer loop of facet 1 endsolid\n")),
        ("crlf", whole("solid\n").replace('\n', "\r\n")),
        ("cr", whole("solid pillar\n").replace('\n', "\r")),
        ("capitals", whole("solid pillar\n").to_uppercase()),
        ("one line", whole("solid pillar\n").replace('\n', " ")),
        ("blank lines", whole("solid pillar\n").replace('\n', "\n\n")),
        ("nan", whole("solid\n").replace("0 0 0\n  outer", "nan nan nan\n  outer")),
        ("nan of Windows", whole("solid\n").replace("normal 0 0 0", "normal -1.#IND 0 -nan(ind)")),
        ("no normals", whole("solid\n").replace(" normal 0 0 0", "")),
        ("no newline at the end", whole("solid\n").trim_end().to_owned()),
    ] {
        assert_pillar(&format!("{name}.stl"), text);
    }
    let latin1 = [b"solid S\xe4ule\n", body.as_bytes(), b"endsolid S\xe4ule\n"].concat();
    assert_pillar("latin1.stl", latin1);
    // Loops of four corners are no STL and are written.
    let corners: Vec<String> =
        (pillar().vertices.iter()).map(|x| format!("vertex {} {} {}\n", x.x, x.y, x.z)).collect();
    let quads = SIDES.map(|side| {
        let vertices = side.map(|corner| corners[corner].clone()).concat();
        format!("facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    });
    assert_pillar("quads.stl", format!("solid\n{}endsolid\n", quads.concat()));
    for header in [&b"solid of a program"[..], b"\xff\xfe", b"\xef\xbb\xbfsolid\n"] {
        assert_pillar("binary.stl", binary_stl(&pillar(), header));
    }
    assert_pillar("binary_newline.stl", [binary_stl(&pillar(), b""), b"\r\n".to_vec()].concat());

    let utf16: Vec<u8> = [0xff, 0xfe].into_iter().chain(whole("solid\n").bytes().flat_map(|byte| [byte, 0])).collect();
    assert_refused("utf16.stl", utf16, &["UTF-16"]);
    let comma = whole("solid\n").replace("0.4 ", "0,4 ");
    assert_refused("comma.stl", comma, &["comma.stl:4:", "`0,4` is not a number", "with a point"]);
    let early = whole("solid\n").replace("endsolid", "");
    assert_refused("early.stl", early, &["the file ends", "`endsolid`"]);
    assert_refused("late.stl", whole("solid\n") + "and more\n", &["`and` where `solid` belongs"]);
    assert_refused("two.stl", whole("solid\n").replace("endloop", ""), &["facet 1", "`endloop`"]);
    assert_refused("headless.stl", body, &["not an STL file", "`solid`"]);
}

#[test]
fn all_solids_of_an_stl_are_read() {
    let left = Surface::cuboid(DVec3::new(0.2, 0.0, 0.4), DVec3::new(0.4, 0.6, 0.6));
    let right = left.clone().map(|x| x + DVec3::X);
    let solid = |name: &str, surface: &Surface| format!("solid {name}\n{}endsolid {name}\n", facets(surface, "0 0 0"));
    let part = |triangles: &[[u32; 3]]| Surface { triangles: triangles.to_vec(), ..left.clone() };
    let patches = solid("floor", &part(&left.triangles[..4])) + "\n" + &solid("rest", &part(&left.triangles[4..]));
    assert!((read("patches.stl", patches).unwrap().volume() - 0.024).abs() < 2e-8);
    let text = solid("left", &left) + &solid("right", &right);
    let one_line = text.replace('\n', " ");
    let binary = [binary_stl(&left, b""), binary_stl(&right, b"solid")].concat();
    let both = read("text.stl", &text).unwrap();
    for (name, bytes) in [("one_line.stl", one_line.as_bytes()), ("binary.stl", &binary)] {
        assert_eq!(read(name, bytes).unwrap(), both, "{name}");
    }
    for n in [1, 40, 84, 200] {
        assert_refused("cut.stl", &binary[..binary.len() - n], &["left over"]);
    }

    // A basin of 1.6 x 1.0 m with 0.4 m of water, both pillars on planes of the grid.
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("two.stl"), text).unwrap();
    let file = folder.path().join("scene.toml");
    let scene = "[domain]\nsize = [1.6, 0.8, 1.0]\ncells = [32, 16, 20]\n[time]\nduration = 0.1\n[[liquid.region]]\n\
        box = { min = [0, 0, 0], max = [1.6, 0.4, 1.0] }\n[[obstacle]]\nmesh = { file = \"two.stl\" }\n";
    fs::write(&file, scene).unwrap();
    let scene = Scene::load(&file, &[], 1.0).unwrap();
    let grid = scene.grid();
    let distance = geometry::cut_cells(&scene, &grid).unwrap().solid_distance;
    let volume: f64 = (0..grid.n_cells())
        .filter(|&cell| grid.cell_centre(grid.cell_at(cell)).y < 0.4)
        .map(|cell| geometry::open_volume(distance[cell], grid.dx) * grid.dx.powi(3))
        .sum();
    assert!((volume - 0.608).abs() < 1e-6, "{volume}");
}

// OBJ

#[test]
fn obj_of_many_programs_is_read() {
    let pillar = pillar();
    let position =
        |end: &str| -> String { pillar.vertices.iter().map(|x| format!("v {} {}{end}{}\n", x.x, x.y, x.z)).collect() };
    let v = position(" ");
    let face = |corner: &dyn Fn(usize) -> String, middle: &str| -> String {
        let face = |side: [usize; 4]| {
            let [a, b, c, d] = side.map(corner);
            format!("f {a} {b}{middle}{c} {d}\n")
        };
        SIDES.map(face).concat()
    };
    let plain = |corner: usize| (corner + 1).to_string();
    let f = face(&plain, " ");
    for (name, text) in [
        ("plain", v.clone() + &f),
        ("faces first", f.clone() + &v),
        ("mark", format!("\u{feff}{v}{f}")),
        ("mark and comment", format!("\u{feff}# exported\n{v}{f}")),
        ("joined faces", v.clone() + &face(&plain, " \\\n")),
        ("joined faces, crlf", (v.clone() + &face(&plain, "\\\n ")).replace('\n', "\r\n")),
        ("joined twice", v.clone() + &face(&plain, " \\\n\\\n")),
        ("spaces behind", v.clone() + &face(&plain, " \\  \n")),
        ("joined vertices", position(" \\\n ") + &f),
        ("joined at the end", format!("{v}{} \\", f.trim_end())),
        ("a path in a comment", format!("# C:\\bodies\\\n{v}mtllib C:\\\n{f}")),
        ("joined names", format!("{v}g one \\\n two three\n{f}")),
        ("one texture coordinate", format!("{v}vt 0.5\n{}", face(&|c| format!("{}/1", c + 1), " "))),
        ("slashes", v.clone() + &face(&|c| format!("{}/", c + 1), " ")),
        ("normals", format!("{v}vn 0 0 1\n{}", face(&|c| format!("{}//1", c + 1), " "))),
        ("relative", v.clone() + &face(&|c| format!("{}", c as i64 - 8), " ")),
        ("colours", position(" ").replace('\n', " 0.5 0.5 0.5 1.0\n") + &f),
        ("comments behind", v.replace('\n', " # here\\\n") + &f),
        ("lines and points", format!("{v}l 1 2 3\np 1\n{f}")),
        ("groups", format!("o a\n{v}g b c\ns off\nusemtl none\n{f}")),
        ("capitals", (v.clone() + &f).to_uppercase()),
        ("cr", (v.clone() + &f).replace('\n', "\r")),
        ("exponents", v.replace("0.4", "+4.0e-001").replace("0.6", ".6") + &f),
        ("corner twice", format!("{v}{}", f.replace("f 1 5 7 3", "f 1 5 5 7 3 1"))),
    ] {
        assert_pillar(&format!("{name}.obj"), text);
    }
    for latin1 in [&b"# S\xe4ule f\xfcr\n"[..], b"g S\xe4ule\n", b"usemtl S\xe4ule\\\n"] {
        assert_pillar("latin1.obj", [latin1, (v.clone() + &f).as_bytes()].concat());
    }

    let replaced = |from: &str, to: &str| (v.clone() + &f).replacen(from, to, 1);
    for (text, words) in [
        (replaced("v 0.4 0 0.4", "v 0,4 0 0.4"), ["mesh.obj:1:", "`0,4` is not a number (dec"]),
        (replaced("v 0.4 0 0.4", "v 0.4 0"), ["mesh.obj:1:", "fewer than three"]),
        (replaced("v 0.4 0 0.4", "v 0.4 0\\\n0.4"), ["mesh.obj:1:", "in two"]),
        (replaced("f 1 5 7 3", "f 1 5 7 9"), ["mesh.obj:9:", "vertex 9 is out of bounds: 8"]),
        (replaced("f 1 5 7 3", "f 1 5 7 0"), ["mesh.obj:9:", "out of bounds"]),
        (replaced("f 1 5 7 3", "f 1 5 7 -9"), ["mesh.obj:9:", "out of bounds"]),
        (replaced("f 1 5 7 3", "f 1 5"), ["mesh.obj:9:", "fewer than three different corners"]),
        (replaced("f 1 5 7 3", "surf 0 1 0 1 1 2 3 4"), ["mesh.obj:9:", "free-form"]),
        (replaced("f 1 5 7 3", "face 1 5 7 3"), ["mesh.obj:9:", "no statement of an OBJ file"]),
        (format!("l 1 2 3\n{v}"), ["mesh.obj", "no triangles"]),
    ] {
        assert_refused("mesh.obj", text, &words);
    }
    let utf16: Vec<u8> = [0xfe, 0xff].into_iter().chain(v.bytes().flat_map(|byte| [0, byte])).collect();
    assert_refused("utf16.obj", utf16, &["UTF-16"]);
}

// Polygons

/// An extruded profile (x, y), counter-clockwise, along z: its corners, then its polygons. The ends are one polygon each.
struct Extrusion {
    vertices: Vec<DVec3>,
    polygons: Vec<Vec<usize>>,
}

impl Extrusion {
    fn new(profile: &[[f64; 2]], [low, high]: [f64; 2], turn: DMat3) -> Extrusion {
        let n = profile.len();
        let vertices =
            [low, high].into_iter().flat_map(|z| profile.iter().map(move |&[x, y]| turn * DVec3::new(x, y, z)));
        let sides = (0..n).map(|i| vec![i, (i + 1) % n, (i + 1) % n + n, i + n]);
        let ends = [(0..n).map(|i| i + n).collect(), (0..n).rev().collect()];
        Extrusion { vertices: vertices.collect(), polygons: sides.chain(ends).collect() }
    }

    /// Every polygon begins `first` corners later.
    fn begun_at(&self, first: usize) -> Vec<Vec<usize>> {
        let polygons = self.polygons.iter().cloned();
        let turned = polygons.map(|mut polygon| {
            let n = polygon.len();
            polygon.rotate_left(first % n);
            polygon
        });
        turned.collect()
    }

    fn obj(&self, first: usize) -> String {
        let vertices = self.vertices.iter().map(|x| format!("v {} {} {}\n", x.x, x.y, x.z));
        let faces = self.begun_at(first).into_iter().map(|polygon| {
            let corners: Vec<String> = polygon.iter().map(|corner| (corner + 1).to_string()).collect();
            format!("f {}\n", corners.join(" "))
        });
        vertices.chain(faces).collect()
    }

    fn ply(&self, first: usize) -> String {
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            self.vertices.len(),
            self.polygons.len()
        );
        let vertices = self.vertices.iter().map(|x| format!("{} {} {}\n", x.x, x.y, x.z));
        let faces = self.begun_at(first).into_iter().map(|polygon| {
            let corners: Vec<String> = polygon.iter().map(ToString::to_string).collect();
            format!("{} {}\n", polygon.len(), corners.join(" "))
        });
        [header].into_iter().chain(vertices).chain(faces).collect()
    }

    fn area_and_volume(&self, profile: &[[f64; 2]], length: f64) -> [f64; 2] {
        let next = profile.iter().cycle().skip(1);
        let (mut around, mut area) = (0.0, 0.0);
        for ([x, y], [u, v]) in profile.iter().zip(next) {
            around += (u - x).hypot(v - y);
            area += 0.5 * (x * v - u * y);
        }
        [around * length + 2.0 * area, area * length]
    }
}

#[test]
fn concave_polygons_are_the_same_solid_whichever_corner_is_first() {
    let trough = [[0.2, 0.1], [1.4, 0.1], [1.4, 0.7], [1.2, 0.7], [1.2, 0.3], [0.4, 0.3], [0.4, 0.7], [0.2, 0.7]];
    let dart = [[0.4, 0.2], [0.8, 0.35], [1.2, 0.2], [0.8, 0.9]];
    // Corners in the middle of straight edges, which the polygons beside them have, too.
    let straight =
        [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0], [0.7, 1.0], [0.5, 0.2], [0.3, 1.0], [0.0, 1.0]];
    let star: Vec<[f64; 2]> = (0..14)
        .map(|i| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 14.0).sin_cos();
            let radius = if i % 2 == 0 { 1.0 } else { 0.3 };
            [radius * cos, radius * sin]
        })
        .collect();
    let gear: Vec<[f64; 2]> = (0..100)
        .map(|i| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 100.0).sin_cos();
            let radius = if i / 5 % 2 == 0 { 1.0 } else { 0.8 };
            [radius * cos, radius * sin]
        })
        .collect();
    let turned = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7);
    let flat = DMat3::IDENTITY;
    let profiles: [&[[f64; 2]]; 5] = [&trough, &dart, &straight, &star, &gear];
    for (number, profile) in profiles.into_iter().enumerate() {
        for turn in [flat, turned, DMat3::from_rotation_x(2.0)] {
            let body = Extrusion::new(profile, [0.2, 0.8], turn);
            let expected = body.area_and_volume(profile, 0.6);
            let first = read("body.obj", body.obj(0)).unwrap();
            let got = [first.area(), first.volume()];
            for (got, expected) in got.into_iter().zip(expected) {
                assert!((got / expected - 1.0).abs() < 1e-12, "profile {number}: {got}, expected {expected}");
            }
            assert_eq!(first.triangles.len(), 4 * profile.len() - 4);
            // The same triangles, but for the order of their corners.
            let set = |surface: &Surface| -> BTreeSet<Vec<[u64; 3]>> {
                let triangle = |number| {
                    let mut corners = surface.corners(number).map(|x| x.to_array().map(f64::to_bits)).to_vec();
                    corners.sort_unstable();
                    corners
                };
                (0..surface.triangles.len()).map(triangle).collect()
            };
            for start in (0..profile.len()).step_by(1 + profile.len() / 20) {
                for (name, text) in [("body.obj", body.obj(start)), ("body.ply", body.ply(start))] {
                    let surface = read(name, text).unwrap();
                    assert_eq!(set(&surface), set(&first), "profile {number} from corner {start}");
                }
            }
        }
    }
    assert!((Extrusion::new(&trough, [0.2, 0.8], flat).area_and_volume(&trough, 0.6)[1] - 0.24).abs() < 1e-12);
}

/// The distance to a trough whose ends begin at a re-entrant corner is that to the three boxes of which it consists, and its inside is air.
#[test]
fn a_trough_of_concave_polygons_is_the_union_of_its_boxes() {
    let folder = tempfile::tempdir().unwrap();
    let trough = [[0.2, 0.1], [1.4, 0.1], [1.4, 0.7], [1.2, 0.7], [1.2, 0.3], [0.4, 0.3], [0.4, 0.7], [0.2, 0.7]];
    let body = Extrusion::new(&trough, [0.2, 0.8], DMat3::IDENTITY);
    let boxes = [[[0.2, 0.1], [1.4, 0.3]], [[0.2, 0.1], [0.4, 0.7]], [[1.2, 0.1], [1.4, 0.7]]];
    let expected = |x: DVec3| {
        let outside = boxes.map(|[low, high]| {
            let [low, high] = [DVec3::new(low[0], low[1], 0.2), DVec3::new(high[0], high[1], 0.8)];
            (low - x).max(x - high).max(DVec3::ZERO).length()
        });
        outside.into_iter().fold(f64::INFINITY, f64::min)
    };
    for start in [0, 4, 5] {
        fs::write(folder.path().join("trough.obj"), body.obj(start)).unwrap();
        let file = folder.path().join("scene.toml");
        let scene = "[domain]\nsize = [1.6, 1.2, 1.0]\ncells = [32, 24, 20]\n[time]\nduration = 0.1\n[[liquid.region]]\n\
            mesh = { file = \"trough.obj\" }\n[[obstacle]]\nmesh = { file = \"trough.obj\" }\n";
        fs::write(&file, scene).unwrap();
        let scene = Scene::load(&file, &[], 1.0).unwrap();
        let grid = scene.grid();
        let obstacle = geometry::cut_cells(&scene, &grid).unwrap().solid_distance;
        let liquid = geometry::liquid_distance(&scene, &grid).unwrap();
        let mut inside = 0;
        for cell in 0..grid.n_cells() {
            let x = grid.cell_centre(grid.cell_at(cell));
            let outside = expected(x);
            inside += usize::from(outside == 0.0);
            for distance in [obstacle[cell], liquid[cell]] {
                let distance = distance.max(0.0).min(3.0 * grid.dx);
                assert!((distance - outside.min(3.0 * grid.dx)).abs() < 1e-12, "{x}: {distance}, expected {outside}");
            }
        }
        assert!((inside as f64 * grid.dx.powi(3) - 0.24).abs() < 1e-12);
    }
}

#[test]
fn polygons_with_bridges_are_read_and_those_that_cross_themselves_are_refused() {
    // A frame: the ends pass the bridge between outer and inner ring twice.
    let rings = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nv 1 1 0\nv 2 1 0\nv 2 2 0\nv 1 2 0\n";
    let far = rings.replace(" 0\n", " 1\n");
    let ends = "f 9 10 11 12 9 13 16 15 14 13\nf 1 5 6 7 8 5 1 4 3 2\n";
    let sides: String = (0..4)
        .map(|i| {
            let j = (i + 1) % 4;
            let side = |a: usize, b: usize| format!("f {} {} {} {}\n", a + 1, b + 1, b + 9, a + 9);
            side(i, j) + &side(j + 4, i + 4)
        })
        .collect();
    let frame = read("frame.obj", format!("{rings}{far}{ends}{sides}")).unwrap();
    assert!((frame.volume() - 8.0).abs() < 1e-14 && (frame.area() - 32.0).abs() < 1e-13);

    let bow = "v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nv 0.5 2 0\n";
    for (face, word) in [
        ("f 1 2 3 5\n", "crosses or touches itself"),
        ("f 1 2 3 5 4\n", "crosses or touches itself"),
        ("f 1 2 1 2\n", "has no area"),
        ("f 1 2 3 4\n", "has no area"),
        ("f 1 1 2\n", "fewer than three different corners"),
    ] {
        assert_refused("bow.obj", format!("{bow}{face}"), &["bow.obj:6:", word]);
    }
    let ply = Extrusion::new(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.5, 2.0]], [0.0, 1.0], DMat3::IDENTITY);
    assert_refused("bow.ply", ply.ply(0), &["face 5: it crosses or touches itself"]);
    // A quadrilateral that is not flat has two triangulations; the first corner chooses neither.
    let tent = "v 0 0 0\nv 1 0 0\nv 1 1 0.3\nv 0 1 0\nv 0.5 0.5 2\n";
    let volumes = ["1 4 3 2", "4 3 2 1", "3 2 1 4", "2 1 4 3"].map(|base| {
        let text = format!("{tent}f {base}\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n");
        read("tent.obj", text).unwrap().volume()
    });
    assert!(volumes.iter().all(|volume| (volume - volumes[0]).abs() < 1e-15), "{volumes:?}");
}

// PLY

#[test]
fn ply_of_many_tools_is_read() {
    let pillar = pillar();
    let head = |format: &str, elements: &str| format!("ply\nformat {format} 1.0\n{elements}end_header\n");
    let vertex = "element vertex 8\nproperty float x\nproperty float y\nproperty float z\n";
    let face = "element face 6\nproperty list uchar int vertex_indices\n";
    let v: String = pillar.vertices.iter().map(|x| format!("{} {} {}\n", x.x, x.y, x.z)).collect();
    let f = SIDES.map(|[a, b, c, d]| format!("4 {a} {b} {c} {d}\n")).concat();
    let text = |elements: &str, data: &str| head("ascii", elements) + data;
    let plain = text(&format!("{vertex}{face}"), &(v.clone() + &f));
    let strips: String = SIDES.map(|[a, b, c, d]| format!(" {a} {b} {d} {c} -1")).concat();
    let strip = "element tristrips 1\nproperty list int int vertex_indices\n";
    for (name, text) in [
        ("plain", plain.clone()),
        ("mark", format!("\u{feff}{plain}")),
        ("crlf", plain.replace('\n', "\r\n")),
        ("cr", plain.replace('\n', "\r")),
        ("blank lines", text(&format!("comment\n\n{vertex}{face}"), &format!("\n{v}\n\n{f}\n \n"))),
        ("faces first", text(&format!("{face}{vertex}"), &(f.clone() + &v))),
        ("strips", text(&format!("{vertex}{strip}"), &format!("{v}30{strips}\n"))),
        ("a strip that turns back", text(&format!("{vertex}{strip}"), &format!("{v}32{strips} 0 0\n"))),
        (
            "edges",
            text(
                &format!("{vertex}{face}element edge 1\nproperty int vertex1\nproperty int vertex2\n"),
                &format!("{v}{f}0 1\n"),
            ),
        ),
        ("nothing of an element", text(&format!("element camera 3\n{vertex}{face}"), &(v.clone() + &f))),
    ] {
        assert_pillar(&format!("{name}.ply"), text);
    }
    // Whole coordinates, in steps of a fifth of a metre.
    let whole: String =
        pillar.vertices.iter().map(|x| format!("{} {} {}\n", 5.0 * x.x, 5.0 * x.y, 5.0 * x.z)).collect();
    let whole = text(&format!("{}{face}", vertex.replace("float", "short")), &(whole + &f));
    assert!((read("whole.ply", whole).unwrap().volume() - 3.0).abs() < 1e-14);

    let binary = |newline: &str, big_endian: bool, first: f32| {
        let format = if big_endian { "binary_big_endian" } else { "binary_little_endian" };
        let elements = format!("{vertex}property uchar red\n{face}property double quality\n");
        let mut bytes = head(format, &elements).replace('\n', newline).into_bytes();
        let ordered = |mut bytes: Vec<u8>| {
            if big_endian {
                bytes.reverse();
            }
            bytes
        };
        for x in &pillar.vertices {
            for x in x.to_array() {
                let x = if x == 0.4 { first } else { x as f32 };
                bytes.extend(ordered(x.to_le_bytes().to_vec()));
            }
            bytes.push(7);
        }
        for side in SIDES {
            bytes.push(4);
            bytes.extend(side.into_iter().flat_map(|corner| ordered((corner as i32).to_le_bytes().to_vec())));
            bytes.extend([0; 8]);
        }
        bytes
    };
    for newline in ["\n", "\r\n", "\r"] {
        for big_endian in [false, true] {
            assert_pillar("binary.ply", binary(newline, big_endian, 0.4));
        }
        // Data that begin with the bytes of newlines. With CR alone, LF behind it is of the data.
        for byte in [b'\n', b'\r'] {
            let [_, rest @ ..] = 0.4_f32.to_le_bytes();
            let first = f32::from_le_bytes([byte, rest[0], rest[1], rest[2]]);
            let surface = read("binary.ply", binary(newline, false, first)).unwrap();
            assert!((surface.volume() - 0.024).abs() < 2e-6 && surface.vertices.len() == 8);
        }
    }

    let bytes = binary("\n", false, 0.4);
    for (bytes, words) in [
        (plain.clone() + "4 0 1 2 3\n", ["left over", "one mesh a file"]),
        (plain.replace("face 6", "face 5"), ["left over", "counts"]),
        (plain.replace("face 6", "face 7"), ["ends too early", "face 7 of 7"]),
        (plain.replace("face 6", "face 18446744073709551615"), ["ends too early", "face 7 of"]),
        (plain.replace("4 0 4 6 2", "4 0 4 6 2 1"), [":18:", "more values than"]),
        (plain.replace("4 0 4 6 2", "4 0 4 6"), [":18:", "fewer values than"]),
        (plain.replace("4 0 4 6 2", "4 0 4 6 2.5"), [":18:", "broken number"]),
        (plain.replace("4 0 4 6 2", "4 0 4 6 -1"), ["face 1:", "-1 is no number of a vertex"]),
        (plain.replace("0.4 0 0.4", "0,4 0 0.4"), [":10:", "with a point"]),
        (plain.replace("list uchar int", "list uchar float"), ["`face`", "whole numbers"]),
        (plain.replace("element face", "element cell"), ["no element `face`", "cure"]),
        (
            text(&format!("{vertex}{face}{}", face.replace("face", "cells")), &(v.clone() + &f + &f)),
            ["`cells`", "not read"],
        ),
        (plain.replace("end_header", "end"), ["`end`", "header"]),
    ] {
        assert_refused("mesh.ply", bytes, &words);
    }
    assert_refused("mesh.ply", [&bytes[..], b"\0"].concat(), &["1 bytes are left over"]);
    assert_refused("mesh.ply", &bytes[..bytes.len() - 1], &["ends too early", "face 6 of 6"]);
}

// Surfaces that bound no solid

fn join(parts: &[Surface]) -> Surface {
    let mut all = Surface::default();
    for part in parts {
        let first = all.vertices.len() as u32;
        all.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
        all.vertices.extend(&part.vertices);
    }
    all.welded()
}

fn problem(surface: &Surface) -> String {
    surface.fault().expect("a fault").problem
}

#[test]
fn surfaces_that_fold_or_cross_themselves_are_refused() {
    // The trough with its ends cut into fans, as careless exporters do: from corner 5 they leave the polygon.
    let trough = [[0.2, 0.1], [1.4, 0.1], [1.4, 0.7], [1.2, 0.7], [1.2, 0.3], [0.4, 0.3], [0.4, 0.7], [0.2, 0.7]];
    for turn in [DMat3::IDENTITY, DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7)] {
        for first in 0..8 {
            let body = Extrusion::new(&trough, [0.2, 0.8], turn);
            let fans = body.begun_at(first).into_iter().flat_map(|polygon| {
                let fan: Vec<[u32; 3]> = (polygon[1..].windows(2))
                    .map(|pair| [polygon[0], pair[0], pair[1]].map(|corner| corner as u32))
                    .collect();
                fan
            });
            // In single precision, too.
            for round in [|x: DVec3| x, |x: DVec3| x.as_vec3().as_dvec3()] {
                let surface = Surface {
                    vertices: body.vertices.iter().copied().map(round).collect(),
                    triangles: fans.clone().collect(),
                };
                assert!((surface.volume() - 0.24).abs() < 1e-6);
                let problem = problem(&surface);
                // Triangles of corners on one line have no area.
                let expected = ["folds over itself", "has no area"];
                assert!(expected.iter().any(|word| problem.contains(word)), "{problem}");
            }
        }
    }

    // A bow tie extruded: the smaller half is inside out.
    let bow = |half: f64| {
        let profile = [[-1.0, -1.0], [half, half], [half, -half], [-1.0, 1.0]];
        let body = Extrusion::new(&profile, [0.0, 1.0], DMat3::IDENTITY);
        let sides = body.polygons[..4].iter().flat_map(|p| [[p[0], p[1], p[2]], [p[0], p[2], p[3]]]);
        let ends = [[4, 5, 6], [4, 6, 7], [3, 2, 1], [3, 1, 0]];
        let surface = Surface {
            vertices: body.vertices,
            triangles: sides.chain(ends).map(|t| t.map(|corner| corner as u32)).collect(),
        };
        if surface.volume() < 0.0 { surface.inside_out() } else { surface }
    };
    for half in [0.5, 0.1, 0.02] {
        let problem = problem(&bow(half));
        assert!(problem.contains("crosses itself") || problem.contains("folds"), "{half}: {problem}");
    }
    // Hoses along a closed curve: one that passes through itself, and the same where it passes by.
    let hose = |lift: f64| {
        let (n, m) = (120_u32, 12_u32);
        let at = |i: u32| {
            let t = std::f64::consts::TAU * f64::from(i) / f64::from(n);
            DVec3::new((2.0 * t).sin(), 1.5 * t.sin(), lift * t.cos())
        };
        let mut vertices = Vec::new();
        for i in 0..n {
            let along = (at(i + 1) - at(i + n - 1)).normalize();
            let side = along.cross(DVec3::Z).normalize();
            let up = side.cross(along);
            for j in 0..m {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(j) / f64::from(m)).sin_cos();
                vertices.push(at(i) + 0.1 * (cos * side + sin * up));
            }
        }
        let vertex = |i: u32, j: u32| i % n * m + j % m;
        let triangles = (0..n * m).flat_map(|k| {
            let (i, j) = (k / m, k % m);
            let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
            [[a, b, c], [a, c, d]]
        });
        let surface = Surface { vertices, triangles: triangles.collect() };
        if surface.volume() < 0.0 { surface.inside_out() } else { surface }
    };
    assert_eq!(hose(0.5).fault(), None);
    assert!(problem(&hose(0.05)).contains("crosses itself"));
}

#[test]
fn thin_and_hollow_bodies_are_no_crossings() {
    let turn = DMat3::from_axis_angle(DVec3::new(2.0, 1.0, 2.0) / 3.0, 1.1);
    let plate = |thickness: f64| Surface::cuboid(DVec3::ZERO, DVec3::new(1.0, thickness, 0.7));
    let wedge = |height: f64| Surface {
        vertices: vec![
            DVec3::ZERO,
            DVec3::X,
            DVec3::new(1.0, height, 0.0),
            DVec3::Z,
            DVec3::new(1.0, 0.0, 1.0),
            DVec3::new(1.0, height, 1.0),
        ],
        triangles: vec![[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [0, 3, 5], [0, 5, 2]],
    };
    let ball = Surface::sphere(DVec3::ZERO, 1.0, 0.5);
    let shell = |share: f64| join(&[ball.clone(), ball.clone().map(|x| share * x).inside_out()]);
    for (name, body) in [
        ("plate", plate(1e-3)),
        ("foil", plate(1e-6)),
        ("wedge", wedge(1e-2)),
        ("blade", wedge(1e-4)),
        ("needle", Surface::cylinder(DVec3::ZERO, DVec3::X, 1e-5, 1.0, 1e-4)),
        ("shell", shell(0.9)),
        ("skin", shell(1.0 - 1e-6)),
    ] {
        for body in [body.clone(), body.map(|x| turn * x + 3.0)] {
            assert!(body.volume() > 0.0, "{name}");
            assert_eq!(body.fault(), None, "{name}");
        }
    }
}

#[test]
fn parts_that_overlap_at_a_corner_or_in_one_place_are_refused() {
    let ball = Surface::sphere(DVec3::ZERO, 0.1, 0.05);
    let corner = ball.vertices[0];
    // Mirrored at a corner, then drawn nearer about it: it stays shared.
    let towards = |share: f64| {
        let other = ball.clone().map(|x| corner + share * (corner - x)).inside_out();
        // Without exact coordinates the corner would be another one.
        Surface {
            vertices: other.vertices.iter().map(|&x| if x.distance(corner) < 1e-12 { corner } else { x }).collect(),
            ..other
        }
    };
    let touching = join(&[ball.clone(), towards(0.5)]);
    assert_eq!(touching.vertices.len(), 2 * ball.vertices.len() - 1);
    let overlapping = |share: f64| {
        let part = ball.clone().map(|x| corner + share * (x - corner));
        let part = part.map(|x| if x.distance(corner) < 1e-12 { corner } else { x });
        // A ball turned about an axis through the corner.
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 1.2);
        part.map(|x| if x == corner { x } else { corner + turn * (x - corner) })
    };
    for share in [1.0, 0.7] {
        let both = join(&[ball.clone(), overlapping(share)]);
        assert_eq!(both.vertices.len(), 2 * ball.vertices.len() - 1);
        assert!(problem(&both).contains("overlap"), "{}", problem(&both));
    }
    // The smaller one lies in the larger, but for the corner.
    let within = ball.clone().map(|x| corner + 0.3 * (x - corner));
    let within = within.map(|x| if x.distance(corner) < 1e-12 { corner } else { x });
    assert!(problem(&join(&[ball.clone(), within])).contains("overlap"));
    // One place: the same triangles, and others.
    assert!(problem(&join(&[ball.clone(), ball.clone()])).contains("lie in one place"));
    let turned = ball.clone().map(|x| DMat3::from_rotation_x(0.1) * x);
    assert!(problem(&join(&[ball.clone(), turned])).contains("overlap"));
    // Boxes that share a corner and nothing else bound a solid.
    let unit = Surface::cuboid(DVec3::ZERO, DVec3::ONE);
    assert_eq!(join(&[unit.clone(), unit.map(|x| x + 1.0)]).fault(), None);
}

// Left over

#[test]
fn nothing_behind_the_last_element_is_dropped() {
    let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = TetMesh { nodes: points.map(DVec3::from_array).to_vec(), elements: vec![[0, 1, 2, 3]] };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mesh.vtu");
    write_mesh(&file, &mesh).unwrap();
    let vtu = fs::read(&file).unwrap();
    let msh = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n3 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n\
        $Elements\n1 1 1 1\n3 1 4 1\n1 1 2 3 4\n$EndElements\n";
    let ascii = |connectivity: &str| {
        format!(
            "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"4\" NumberOfCells=\"1\"><Points>\
             <DataArray type=\"Float64\" format=\"ascii\">0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points><Cells>\
             <DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">{connectivity}</DataArray>\
             <DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">4</DataArray>\
             <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">10</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>"
        )
    };
    let read = |name: &str, bytes: &[u8]| parse_tets(bytes, Path::new(name)).map_err(|error| error.to_string());
    for (name, bytes) in [("m.msh", msh.as_bytes()), ("a.vtu", ascii("0 1 2 3").as_bytes()), ("w.vtu", &vtu)] {
        assert_eq!(read(name, bytes).unwrap().mesh.elements.len(), 1, "{name}");
    }
    for (name, bytes, word) in [
        ("m.msh", [msh, msh].concat().into_bytes(), "a second mesh begins here"),
        ("m.msh", [msh, "1 2 3"].concat().into_bytes(), "where a section begins"),
        ("m.msh", msh.replace("4\n$EndE", "4\n2 1 2 3 4\n$EndE").into_bytes(), "where $EndElements belongs"),
        ("a.vtu", ascii("0 1 2 3 0 1 2 3").into_bytes(), "4 numbers are left over behind the last cell"),
        ("w.vtu", [&vtu[..], b"more"].concat(), "w.vtu"),
    ] {
        let error = read(name, &bytes).unwrap_err();
        assert!(error.contains(word), "{name}: {error}");
    }
}

// Files of other libraries

/// Files that trimesh and meshio wrote, with what these libraries find in them; and a file of this program as meshio reads it.
#[test]
fn files_of_trimesh_and_meshio_are_read_as_they_read_them() {
    let Some(python) = python_with("meshio, trimesh") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("own.vtu");
    let ball = Surface::sphere(DVec3::splat(0.3), 0.4, 0.5);
    let filled = geometry::fill(&ball, 0.15).unwrap();
    write_mesh(&own, &filled).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/write_meshes.py");
    let output = Command::new(python).arg(script).arg(folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let files: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut seen = BTreeSet::new();
    for (name, found) in files.as_object().unwrap() {
        let file = folder.path().join(name);
        let extension = file.extension().unwrap().to_str().unwrap();
        seen.insert(extension.to_owned());
        let tetrahedra = ["msh", "vtu"].contains(&extension);
        let (volume, n, [low, high]) = if tetrahedra {
            let mesh = read_tets(&file).unwrap().mesh;
            (mesh.volume(), mesh.elements.len(), mesh.bounds())
        } else {
            let surface = read_mesh(&file).unwrap();
            (surface.volume(), surface.triangles.len(), surface.bounds())
        };
        let number = |key: &str| found[key].as_f64().unwrap();
        // Six to eight digits, or single precision.
        assert!((volume / number("volume") - 1.0).abs() < 1e-5, "{name}: {volume}, {found}");
        assert_eq!(n as f64, number("cells"), "{name}");
        let corners = found["bounds"].as_array().unwrap().iter().flat_map(|corner| corner.as_array().unwrap());
        for (got, expected) in low.to_array().into_iter().chain(high.to_array()).zip(corners) {
            assert!((got - expected.as_f64().unwrap()).abs() < 1e-6, "{name}: {got}, {expected}");
        }
    }
    assert_eq!(Vec::from_iter(seen), ["msh", "obj", "ply", "stl", "vtu"]);
    assert!((files["own.vtu"]["volume"].as_f64().unwrap() / filled.volume() - 1.0).abs() < 1e-12);
}
