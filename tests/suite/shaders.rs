//! Every WGSL file, without a device: it parses, validates with no more capabilities than its variant asks for, its entry point
//! has the file's name, and it binds no more storage buffers than every adapter allows.

use cutwater::gpu::{Real, Source, Variant, compose, validate};

/// `max_storage_buffers_per_shader_stage` of the WebGPU default limits.
const STORAGE_BUFFERS: usize = 8;

fn kernels() -> Vec<Source> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders");
    let mut sources = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "wgsl") {
            sources.push(Source {
                name: path.file_stem().unwrap().to_str().unwrap().to_owned().leak(),
                text: std::fs::read_to_string(&path).unwrap().leak(),
            });
        }
    }
    sources.sort_by_key(|source| source.name);
    sources
}

#[test]
fn every_shader_validates_in_every_variant() {
    let sources = kernels();
    assert!(sources.len() >= 3, "the shaders were found");
    for source in sources {
        let outer: &[Real] = if source.text.contains("#import real") || source.text.contains("#import stencil") {
            &[Real::F32, Real::F64]
        } else {
            &[Real::F32]
        };
        // What the three precisions compile: f32, f64, and f64 around f32 where a kernel has both.
        let mut variants: Vec<Variant> = outer.iter().map(|&real| real.into()).collect();
        if outer.len() > 1 && (source.text.contains("#import inner") || source.text.contains("#import stencil")) {
            variants.push(Variant { real: Real::F64, inner: Real::F32, moving_obstacles: false });
        }
        // Where obstacles move, what imports them reads one buffer more.
        if source.text.contains("#import divergence") {
            let beside = |variant: &Variant| variant.beside_obstacles(true);
            variants.extend(variants.iter().map(beside).collect::<Vec<_>>());
        }
        for variant in variants {
            let composed = compose(&source, variant).unwrap();
            let (module, _) = validate(&composed, variant).unwrap_or_else(|error| panic!("{variant:?}: {error}"));
            assert_eq!(module.entry_points.len(), 1, "{}: entry points", source.name);
            assert_eq!(module.entry_points[0].name, source.name, "entry point");
            let storage = module
                .global_variables
                .iter()
                .filter(|(_, variable)| matches!(variable.space, naga::AddressSpace::Storage { .. }))
                .count();
            assert!(storage <= STORAGE_BUFFERS, "{}: {storage} storage buffers", source.name);
        }
    }
}
