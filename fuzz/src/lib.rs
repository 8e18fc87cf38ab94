//! What every reader of a user's file must hold to, whatever the file: it ends, soon and without a panic, with something sound or with an
//! error of input that has a cure. Fuzzers and the test that replays `corpus/` call the same function.

use std::path::Path;

use cutwater::Error;
use cutwater::geometry::{parse_mesh, parse_tets};
use cutwater::scene::Scene;

/// The readers, by the ends of the names of their files; `scene` reads TOML.
pub const TARGETS: [&str; 7] = ["scene", "obj", "stl", "ply", "glb", "msh", "vtu"];

/// Has one reader read a file; gives the message where it is refused.
///
/// # Panics
/// Where the reader does, gives what is not sound, or an error that does not help.
pub fn read(target: &str, bytes: &[u8]) -> Option<String> {
    let name = format!("fuzz.{target}");
    let file = Path::new(&name);
    let outcome = match target {
        "scene" => scene(bytes),
        "msh" | "vtu" => parse_tets(bytes, file).map(|read| {
            let mesh = read.mesh;
            let corners = mesh.elements.iter().flatten();
            assert!(corners.clone().all(|&corner| (corner as usize) < mesh.nodes.len()));
            assert!(mesh.elements.iter().all(|&element| mesh.determinant(element) > 0.0));
            assert_eq!(read.numbers.len(), mesh.elements.len());
        }),
        _ => parse_mesh(bytes.to_vec(), file).map(|surface| {
            assert_eq!(surface.fault(), None);
            assert!(surface.volume() > 0.0);
        }),
    };
    outcome.err().map(|error| {
        let message = error.to_string();
        assert_eq!(error.exit_code(), 2, "{message}");
        assert!(message.contains("\n  cure: "), "{message}");
        message
    })
}

/// A scene's text; what follows a zero byte is a `--set`.
fn scene(bytes: &[u8]) -> Result<(), Error> {
    let text = String::from_utf8_lossy(bytes);
    let (text, setting) = text.split_once('\0').unwrap_or((&text, ""));
    let settings: Vec<String> = Some(setting.to_owned()).filter(|setting| !setting.is_empty()).into_iter().collect();
    let scene = Scene::parse(Path::new("fuzz.toml"), text, &settings, 1.0)?;
    assert!(scene.n_frames() > 0);
    let grid = scene.grid();
    assert!(grid.dx > 0.0 && grid.dx.is_finite() && grid.n_cells() > 0);
    assert!(scene.domain.size.is_finite() && scene.domain.gravity.is_finite() && scene.camera.eye.is_finite());
    assert!(scene.liquid.is_some() || !scene.solids.is_empty());
    Ok(())
}
