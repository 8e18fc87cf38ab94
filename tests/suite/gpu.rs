//! The GPU layer: compaction, splitting, read-back, error reports.

use cutwater::Error;
use cutwater::gpu::{
    AdapterChoice, Buffer, CompactKernels, Compaction, Gpu, Kernel, Real, RealBuffer, Recorder,
    SPLIT, Source, compose, groups, validate,
};

use crate::common::{Random, gpu};

fn compact(gpu: &Gpu, flags: &[u32], first: usize, n: usize) -> (Vec<u32>, Vec<u32>) {
    let kernels = CompactKernels::new(gpu).unwrap();
    let flags = gpu.buffer_with("test.flags", flags).unwrap();
    let list: Buffer<u32> = gpu.buffer("test.list", flags.len()).unwrap();
    let args: Buffer<u32> = gpu.buffer("test.args", 8).unwrap();
    let scratch: Buffer<u32> = gpu
        .buffer("test.scratch", Compaction::scratch("test.scratch", n).len)
        .unwrap();
    let compaction =
        Compaction::new(gpu, &kernels, &flags, &list, &args, &scratch, [first, n], 1).unwrap();
    let mut recorder = Recorder::new(gpu);
    recorder.stage("compact", |pass| compaction.record(pass));
    recorder.submit();
    (gpu.download(&list).unwrap(), gpu.download(&args).unwrap())
}

/// The bit of a flag that its list entry carries.
const TAG: u32 = 0x8000_0000;

#[test]
fn compaction_lists_the_flags_in_order_with_their_tags() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(1);
    for (n, density) in [
        (4, 1.0),
        (4, 0.0),
        (64, 0.5),
        (1028, 0.3),
        (70_000, 0.02),
        (70_000, 1.0),
        (300_004, 0.6),
    ] {
        let flags: Vec<u32> = (0..n)
            .map(|_| {
                let flag = if random.bits().is_multiple_of(2) {
                    5
                } else {
                    TAG
                };
                u32::from(random.uniform(0.0, 1.0) < density) * flag
            })
            .collect();
        let (list, args) = compact(gpu, &flags, 0, n);
        let expected: Vec<u32> = (0..n as u32)
            .filter(|&i| flags[i as usize] != 0)
            .map(|i| i | flags[i as usize] & TAG)
            .collect();
        assert_eq!(args[7] as usize, expected.len(), "length for {n} flags");
        assert_eq!(
            args[4..7],
            groups((expected.len() as u32).div_ceil(64)),
            "dispatch size for {n} flags"
        );
        assert_eq!(list[..expected.len()], expected, "list for {n} flags");
    }
}

#[test]
fn compaction_of_a_range_leaves_the_rest_alone() {
    let Some(gpu) = gpu() else { return };
    let flags = vec![1; 400];
    let (list, args) = compact(gpu, &flags, 100, 200);
    assert_eq!(args[7], 200, "length");
    assert_eq!(
        list[100..300],
        (100..300).collect::<Vec<u32>>(),
        "the range"
    );
    assert!(
        list[..100].iter().chain(&list[300..]).all(|&i| i == 0),
        "entries outside the range"
    );
}

#[test]
fn dispatches_split_above_the_limit() {
    assert_eq!(groups(0), [0, 1, 1], "nothing");
    assert_eq!(groups(SPLIT), [SPLIT, 1, 1], "the last unsplit size");
    let [x, y, z] = groups(SPLIT + 1);
    assert!(
        x <= 65_535 && y <= 65_535 && z == 1 && x * y > SPLIT,
        "{x} {y} {z}"
    );
}

#[test]
fn constants_shared_with_shaders_are_equal() {
    let text = include_str!("../../shaders/common/dispatch.wgsl");
    assert!(text.contains(&format!("const SPLIT = {SPLIT}u;")), "SPLIT");
    assert!(
        text.contains(&format!("const WG_SIZE = {}u;", cutwater::gpu::WG_SIZE)),
        "WG_SIZE"
    );
}

#[test]
fn real_buffers_round_trip() {
    let Some(gpu) = gpu() else { return };
    let values = [0.1, -3.0, 1e-30, 7e9];
    let narrow = RealBuffer::new(gpu, "test.narrow", 4, Real::F32).unwrap();
    narrow.upload(gpu, &values);
    assert_eq!(
        narrow.download(gpu).unwrap(),
        values.map(|v| f64::from(v as f32)),
        "f32"
    );
    let wide = RealBuffer::new(gpu, "test.wide", 4, Real::F64).unwrap();
    wide.upload(gpu, &values);
    assert_eq!(wide.download(gpu).unwrap(), values, "f64");
}

#[test]
fn shader_errors_name_file_and_line_through_imports() {
    let source = Source {
        name: "broken",
        text: "#import dispatch\n\nfn f() {\n    let x: u32 = 1.5;\n}\n",
    };
    let composed = compose(&source, Real::F32).unwrap();
    match validate(&composed, Real::F32) {
        Err(Error::Shader { file, line, .. }) => {
            assert_eq!((file.as_str(), line), ("shaders/broken.wgsl", 4), "origin")
        }
        other => panic!("{other:?}"),
    }
    let source = Source {
        name: "broken",
        text: "// a\n#import nothing\n",
    };
    match compose(&source, Real::F32) {
        Err(Error::Shader { line, problem, .. }) => {
            assert!(line == 2 && problem.contains("nothing"), "{problem}")
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_unknown_adapter_is_refused_with_the_cure() {
    match Gpu::new(&AdapterChoice::Name("no such adapter".to_owned())) {
        Err(error @ Error::Adapter { .. }) => {
            assert_eq!(error.exit_code(), 3, "exit code");
            assert!(error.to_string().contains("--backend cpu"), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_buffer_beyond_the_limit_is_refused_by_name() {
    let Some(gpu) = gpu() else { return };
    let words = (gpu.report().buffer.min(gpu.report().storage_binding) / 4 + 1) as usize;
    match gpu.buffer::<u32>("test.too_large", words) {
        Err(Error::Limit { what, .. }) => assert!(what.contains("test.too_large"), "{what}"),
        other => panic!("{other:?}"),
    }
}

#[test]
#[should_panic(expected = "nothing bound to chunks")]
fn a_missing_binding_is_a_broken_invariant() {
    let Some(gpu) = gpu() else {
        panic!("nothing bound to chunks: there is no device to try it on")
    };
    let kernel = Kernel::new(gpu, &cutwater::wgsl!("compact_count"), Real::F32).unwrap();
    let range = gpu.uniform("test.range", &[0u32; 4]).unwrap();
    let flags: Buffer<u32> = gpu.buffer("test.flags", 4).unwrap();
    let _ = kernel.bind(
        gpu,
        &[("range", (&range).into()), ("flags", (&flags).into())],
    );
}
