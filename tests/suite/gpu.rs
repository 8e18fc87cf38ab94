//! The GPU layer: compaction, splitting, read-back, error reports.

use cutwater::Error;
use cutwater::gpu::{
    AdapterChoice, Buffer, CompactKernels, Compaction, Entries, Gpu, Kernel, Real, RealBuffer, Recorder, SPLIT, Sort,
    SortKernels, Source, TILE, WG_SIZE, compose, groups, validate,
};

use crate::common::{Random, SKIPPED, gpu};

fn compact(gpu: &Gpu, flags: &[u32], first: usize, n: usize) -> (Vec<u32>, Vec<u32>) {
    let kernels = CompactKernels::new(gpu).unwrap();
    let flags = gpu.buffer_with("test.flags", flags).unwrap();
    let list: Buffer<u32> = gpu.buffer("test.list", flags.len()).unwrap();
    let args: Buffer<u32> = gpu.buffer("test.args", 8).unwrap();
    let scratch: Buffer<u32> = gpu.buffer("test.scratch", Compaction::scratch(n)).unwrap();
    let compaction = Compaction::new(gpu, &kernels, &flags, &list, &args, &scratch, [first, n], 1).unwrap();
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
    for (n, density) in [(4, 1.0), (4, 0.0), (64, 0.5), (1028, 0.3), (70_000, 0.02), (70_000, 1.0), (300_004, 0.6)] {
        let flags: Vec<u32> = (0..n)
            .map(|_| {
                let flag = if random.bits().is_multiple_of(2) { 5 } else { TAG };
                u32::from(random.uniform(0.0, 1.0) < density) * flag
            })
            .collect();
        let (list, args) = compact(gpu, &flags, 0, n);
        let expected: Vec<u32> =
            (0..n as u32).filter(|&i| flags[i as usize] != 0).map(|i| i | flags[i as usize] & TAG).collect();
        assert_eq!(args[7] as usize, expected.len(), "length for {n} flags");
        assert_eq!(args[4..7], groups((expected.len() as u32).div_ceil(64)), "dispatch size for {n} flags");
        assert_eq!(list[..expected.len()], expected, "list for {n} flags");
    }
}

#[test]
fn compaction_of_a_range_leaves_the_rest_alone() {
    let Some(gpu) = gpu() else { return };
    let flags = vec![1; 400];
    let (list, args) = compact(gpu, &flags, 100, 200);
    assert_eq!(args[7], 200, "length");
    assert_eq!(list[100..300], (100..300).collect::<Vec<u32>>(), "the range");
    assert!(list[..100].iter().chain(&list[300..]).all(|&i| i == 0), "entries outside the range");
}

/// Sorts the first `length` entries of a list of (key, place) on the device.
fn sort(gpu: &Gpu, keys: &[u32], length: usize, bits: u32) -> (Vec<u32>, Vec<u32>) {
    let n = keys.len();
    let values: Vec<u32> = (0..n as u32).collect();
    let lists = [
        gpu.buffer_with("test.keys", keys).unwrap(),
        gpu.buffer_with("test.values", &values).unwrap(),
        gpu.buffer("test.spare_keys", n).unwrap(),
        gpu.buffer("test.spare_values", n).unwrap(),
    ];
    let [keys, values, spare_keys, spare_values] = &lists;
    // The lengths of two lists: the second one's counts.
    let args = [9, 9, 9, 9, 0, 0, 0, length as u32];
    let args = gpu.buffer_with("test.args", &args).unwrap();
    let scratch = Sort::scratch("test.scratch", n);
    let scratch = gpu.buffer(&scratch.label, scratch.len).unwrap();
    let kernels = SortKernels::new(gpu).unwrap();
    let entries = Entries { keys, values };
    let spare = Entries { keys: spare_keys, values: spare_values };
    let sort = Sort::new(gpu, &kernels, entries, spare, &scratch, (&args, 1), bits).unwrap();
    let mut recorder = Recorder::new(gpu);
    recorder.stage("sort", |pass| sort.record(pass));
    recorder.submit();
    (gpu.download(keys).unwrap(), gpu.download(values).unwrap())
}

/// That the device sorts as the standard library's stable sort does, and leaves what is beyond the length alone.
fn assert_sorted(gpu: &Gpu, what: &str, keys: &[u32], length: usize, bits: u32) {
    let mask = ((1u64 << bits.next_multiple_of(8)) - 1) as u32;
    let mut places: Vec<u32> = (0..keys.len() as u32).collect();
    places[..length].sort_by_key(|&place| keys[place as usize] & mask);
    let (sorted, values) = sort(gpu, keys, length, bits);
    assert!(values == places, "{what}, {length} of {} entries", keys.len());
    let expected = places.iter().map(|&place| keys[place as usize]);
    assert!(expected.eq(sorted), "{what}: keys go with their values");
}

#[test]
fn sorting_is_stable_and_that_of_the_host() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(5);
    let wg = WG_SIZE as usize;
    let lengths = [0, 1, 2, 15, 16, 17, wg - 1, wg, wg + 1];
    for length in lengths.into_iter().chain([TILE - 1, TILE, TILE + 1, 70_001]) {
        let keys: Vec<u32> = (0..length).map(|_| random.bits() as u32).collect();
        assert_sorted(gpu, "all bits", &keys, length, 32);
        let few: Vec<u32> = keys.iter().map(|key| key % 3).collect();
        assert_sorted(gpu, "equal keys", &few, length, 2);
    }
    let n = 5000u32;
    assert_sorted(gpu, "one key", &vec![u32::MAX; n as usize], n as usize, 32);
    assert_sorted(gpu, "sorted", &Vec::from_iter(0..n), n as usize, 13);
    let reversed = Vec::from_iter((0..n).rev().map(|key| key << 19));
    assert_sorted(gpu, "reversed", &reversed, n as usize, 32);
    let keys: Vec<u32> = (0..n).map(|_| random.bits() as u32).collect();
    assert_sorted(gpu, "a part of the bits", &keys, n as usize, 12);
    assert_sorted(gpu, "a part of the list", &keys, 3001, 32);
    assert_sorted(gpu, "nothing of the list", &keys, 0, 32);
    assert_sorted(gpu, "no bit", &keys, 0, 0);
}

#[test]
fn a_million_entries_are_sorted() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(6);
    let keys: Vec<u32> = (0..1_100_003).map(|_| random.bits() as u32).collect();
    assert_sorted(gpu, "many", &keys, keys.len(), 32);
}

/// Above 65,535 workgroups both ways to dispatch go on along y, and kernels fold that back: every thread has its own index.
#[test]
fn a_split_dispatch_reaches_every_index_once() {
    let Some(gpu) = gpu() else { return };
    let source = Source {
        name: "fold_back",
        text: "#import dispatch\n\
            @group(0) @binding(0) var<storage, read_write> seen: array<u32>;\n\
            @compute @workgroup_size(WG_SIZE)\n\
            fn fold_back(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {\n\
                let ix = linear_index(workgroup, lane);\n\
                if ix < arrayLength(&seen) { seen[ix] += ix + 1u; }\n\
            }\n",
    };
    let kernel = Kernel::new(gpu, &source, Real::F32).unwrap();
    let n = 65_540 * WG_SIZE as usize;
    let seen: Buffer<u32> = gpu.buffer("test.seen", n).unwrap();
    let bound = kernel.bind(gpu, &[("seen", (&seen).into())], &[]).unwrap();
    // The dispatch size that the device makes of that many flags.
    let (list, args) = compact(gpu, &vec![1; n], 0, n);
    assert_eq!(args[4..], [SPLIT, 3, 1, n as u32], "dispatch size");
    assert!(Iterator::eq(0..n as u32, list), "list");
    let args = gpu.buffer_with("test.args", &args).unwrap();
    let mut recorder = Recorder::new(gpu);
    recorder.stage("fold_back", |pass| {
        pass.dispatch(&bound, n);
        pass.dispatch_indirect(&bound, &args, 1);
    });
    recorder.submit();
    let seen = gpu.download(&seen).unwrap();
    assert!(Iterator::eq((0..n as u32).map(|ix| 2 * (ix + 1)), seen));
}

#[test]
fn dispatches_split_above_the_limit() {
    assert_eq!(groups(0), [0, 1, 1], "nothing");
    assert_eq!(groups(SPLIT), [SPLIT, 1, 1], "the last unsplit size");
    let [x, y, z] = groups(SPLIT + 1);
    assert!(x <= 65_535 && y <= 65_535 && z == 1 && x * y > SPLIT, "{x} {y} {z}");
}

#[test]
fn real_buffers_round_trip() {
    let Some(gpu) = gpu() else { return };
    let values = [0.1, -3.0, 1e-30, 7e9];
    let narrow = RealBuffer::new(gpu, "test.narrow", 4, Real::F32).unwrap();
    narrow.upload(gpu, &values);
    assert_eq!(narrow.download(gpu).unwrap(), values.map(|v| f64::from(v as f32)), "f32");
    let wide = RealBuffer::new(gpu, "test.wide", 4, Real::F64).unwrap();
    wide.upload(gpu, &values);
    assert_eq!(wide.download(gpu).unwrap(), values, "f64");
}

#[test]
fn shader_errors_name_file_and_line_through_imports() {
    let source = Source { name: "broken", text: "#import dispatch\n\nfn f() {\n    let x: u32 = 1.5;\n}\n" };
    let composed = compose(&source, Real::F32).unwrap();
    match validate(&composed, Real::F32) {
        Err(Error::Shader { file, line, .. }) => {
            assert_eq!((file.as_str(), line), ("shaders/broken.wgsl", 4), "origin")
        }
        other => panic!("{other:?}"),
    }
    let source = Source { name: "broken", text: "// a\n#import nothing\n" };
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

/// Without an adapter each test that needs one is counted and named, although libtest captures what tests print. With REQUIRE_GPU=1
/// it fails. Vulkan's loader finds no driver; other systems bring theirs.
#[cfg(target_os = "linux")]
#[test]
fn without_an_adapter_tests_are_counted_as_skipped() {
    // Both ways to ask for the device, of several modules; and one test that needs none.
    let needy = ["compare::all_scenes_pass", "coupled_gpu::steps_are_the_twins", "gpu::real_buffers_round_trip"];
    let run = |required: Option<&str>| {
        let mut command = std::process::Command::new(std::env::current_exe().unwrap());
        command
            .args(["--exact", "--test-threads=2"])
            .args(needy)
            .arg("gpu::an_unknown_adapter_is_refused_with_the_cure")
            .env("VK_DRIVER_FILES", "nowhere.json")
            .env_remove("VK_ICD_FILENAMES")
            .env_remove("REQUIRE_GPU");
        command.envs(required.map(|value| ("REQUIRE_GPU", value)));
        let output = command.output().unwrap();
        let [said, told] = [output.stdout, output.stderr].map(|it| String::from_utf8(it).unwrap());
        let skipped = told.lines().filter_map(|line| line.strip_prefix(SKIPPED));
        let skipped = skipped.map(|line| line.split_once(": ").unwrap());
        let [numbers, mut tests] = skipped.fold([const { Vec::new() }; 2], |[mut numbers, mut tests], it| {
            numbers.push(it.0.to_owned());
            tests.push(it.1.to_owned());
            [numbers, tests]
        });
        tests.sort();
        (output.status.code(), said, numbers, tests)
    };
    for required in [None, Some("0")] {
        let (code, said, numbers, tests) = run(required);
        assert!(code == Some(0) && said.contains("4 passed"), "{said}");
        assert_eq!(
            (&numbers[..], &tests[..]),
            (&["1", "2", "3"].map(str::to_owned)[..], &needy.map(str::to_owned)[..])
        );
    }
    let (code, said, _, tests) = run(Some("1"));
    assert!(code == Some(101) && said.contains("1 passed; 3 failed"), "{said}");
    assert!(said.contains("REQUIRE_GPU=1 and ") && tests.is_empty(), "{said}");
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
    let Some(gpu) = gpu() else { panic!("nothing bound to chunks: there is no device to try it on") };
    let kernel = Kernel::new(gpu, &cutwater::wgsl!("compact_count"), Real::F32).unwrap();
    let range = gpu.uniform("test.range", &[0u32; 4]).unwrap();
    let flags: Buffer<u32> = gpu.buffer("test.flags", 4).unwrap();
    let _ = kernel.bind(gpu, &[("range", (&range).into()), ("flags", (&flags).into())], &[]);
}
