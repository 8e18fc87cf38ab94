//! Scene files: good ones, overrides, scale, and what is refused with which words.

use std::path::{Path, PathBuf};

use cutwater::scene::Scene;

fn scene_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("scenes")
        .join(name)
}

#[test]
fn dam_break_loads() {
    let scene = Scene::load(&scene_file("dam_break_liquid.toml"), &[], 1.0).unwrap();
    assert_eq!(scene.name, "dam_break_liquid");
    assert_eq!(scene.domain.cells, [64, 32, 32]);
    assert_eq!(scene.grid().dx, 0.03125);
    assert_eq!(scene.n_frames(), 48);
    assert_eq!(scene.probes.len(), 3);
}
