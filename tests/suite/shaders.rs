//! Every WGSL file, without a device: it parses, validates with no more capabilities than its variant asks for, its entry point
//! has the file's name, and it binds no more storage buffers than every adapter allows.

use cutwater::gpu::{Real, Source, compose, validate};

/// `max_storage_buffers_per_shader_stage` of the WebGPU default limits.
const STORAGE_BUFFERS: usize = 8;

fn kernels() -> Vec<Source> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders");
    let mut sources = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path
            .extension()
            .is_some_and(|extension| extension == "wgsl")
        {
            sources.push(Source {
                name: path
                    .file_stem()
                    .unwrap()
                    .to_str()
                    .unwrap()
                    .to_owned()
                    .leak(),
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
        let variants: &[Real] = if source.text.contains("#import real") {
            &[Real::F32, Real::F64]
        } else {
            &[Real::F32]
        };
        for &real in variants {
            let composed = compose(&source, real).unwrap();
            let (module, _) =
                validate(&composed, real).unwrap_or_else(|error| panic!("{real:?}: {error}"));
            assert_eq!(
                module.entry_points.len(),
                1,
                "{}: entry points",
                source.name
            );
            assert_eq!(module.entry_points[0].name, source.name, "entry point");
            let storage = module
                .global_variables
                .iter()
                .filter(|(_, variable)| {
                    matches!(variable.space, naga::AddressSpace::Storage { .. })
                })
                .count();
            assert!(
                storage <= STORAGE_BUFFERS,
                "{}: {storage} storage buffers",
                source.name
            );
        }
    }
}
