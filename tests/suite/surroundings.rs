//! What is told of a system without a GPU's driver, on made-up systems.

use std::fs;
use std::io;
use std::path::Path;

use cutwater::gpu::Surroundings;
use tempfile::TempDir;

use crate::common::assert_has;

/// A system: files below its root with their text, and variables.
struct System<'a> {
    files: &'a [(&'a str, &'a str)],
    variables: &'a [(&'a str, &'a str)],
    /// Devices that cannot be opened.
    closed: &'a [&'a str],
}

const LOADER: (&str, &str) = ("usr/lib/x86_64-linux-gnu/libvulkan.so.1", "");
const MESA: [(&str, &str); 2] = [
    (
        "usr/share/vulkan/icd.d/radeon_icd.x86_64.json",
        r#"{"ICD": {"library_path": "/usr/lib/x86_64-linux-gnu/libvulkan_radeon.so"}}"#,
    ),
    ("usr/lib/x86_64-linux-gnu/libvulkan_radeon.so", ""),
];
const NVIDIA: (&str, &str) = ("etc/vulkan/icd.d/nvidia_icd.json", r#"{"ICD": {"library_path": "libGLX_nvidia.so.0"}}"#);
const NVIDIA_LIBRARY: (&str, &str) = ("usr/lib64/libGLX_nvidia.so.0", "");
const NVIDIA_DEVICES: [(&str, &str); 2] = [("dev/nvidiactl", ""), ("dev/nvidia0", "")];
const RENDER: (&str, &str) = ("dev/dri/renderD128", "");
const DOCKER: (&str, &str) = (".dockerenv", "");

impl System<'_> {
    fn look(&self) -> (TempDir, Surroundings) {
        let root = tempfile::tempdir().unwrap();
        for (name, text) in self.files {
            let path = root.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let variable = |name: &str| {
            let found = self.variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| value.replace("ROOT", root.path().to_str().unwrap()))
        };
        let open = |path: &Path| match self.closed.iter().any(|closed| path.ends_with(closed)) {
            true => Err(io::ErrorKind::PermissionDenied.into()),
            false => Ok(()),
        };
        let found = Surroundings::look(root.path(), &variable, &open);
        (root, found)
    }
}

/// What is to do, without a GPU found.
fn cures(files: &[&[(&str, &str)]], variables: &[(&str, &str)], closed: &[&str]) -> Vec<String> {
    let files = files.concat();
    let (_root, found) = System { files: &files, variables, closed }.look();
    found.cures(false)
}

#[track_caller]
fn only(cures: &[String], parts: &[&str]) {
    assert_eq!(cures.len(), 1, "{cures:?}");
    assert!(parts.iter().all(|part| cures[0].contains(part)), "{cures:?}, not {parts:?}");
}

#[test]
fn what_is_missing_is_named_with_its_cure() {
    only(&cures(&[], &[], &[]), &["libvulkan.so.1", "libvulkan1"]);
    assert!(cures(&[&[LOADER]], &[], &[]).is_empty(), "nothing to be found, nothing to cure");
    only(&cures(&[&[LOADER, RENDER]], &[], &[]), &["mesa-vulkan-drivers"]);
    let whole = cures(&[&[LOADER, RENDER], &MESA], &[], &[]);
    assert!(whole.is_empty(), "{whole:?}");
    only(&cures(&[&[LOADER, RENDER], &MESA], &[], &["renderD128"]), &["/dev/dri/renderD128", "usermod -aG render"]);
    // A driver for computing alone, on the machine itself and in containers.
    only(&cures(&[&[LOADER], &NVIDIA_DEVICES], &[], &[]), &["libGLX_nvidia.so.0", "nvidia-vulkan-icd"]);
    let compute = [("NVIDIA_DRIVER_CAPABILITIES", "compute,utility")];
    only(
        &cures(&[&[LOADER, DOCKER], &NVIDIA_DEVICES], &compute, &[]),
        &["--gpus all", "NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics", "now compute,utility"],
    );
    only(&cures(&[&[LOADER], &NVIDIA_DEVICES], &[("APPTAINER_NAME", "x")], &[]), &["--nv"]);
    // The manifest is there, its library is not.
    only(&cures(&[&[LOADER, NVIDIA], &NVIDIA_DEVICES], &[], &[]), &["libGLX_nvidia.so.0"]);
    let of_nvidia = [LOADER, NVIDIA, NVIDIA_LIBRARY];
    only(&cures(&[&of_nvidia, &NVIDIA_DEVICES], &[], &[]), &["libx11-6 libxext6 libegl1"]);
    let x11 = [("usr/lib/aarch64-linux-gnu/libX11.so.6", ""), ("lib/libXext.so.6", "")];
    only(&cures(&[&of_nvidia, &x11, &NVIDIA_DEVICES], &[], &[]), &["needs libEGL.so.1", "apt-get install libegl1)"]);
    let manifest = [("VK_DRIVER_FILES", "ROOT/etc/vulkan/icd.d/nvidia_icd.json")];
    only(&cures(&[&of_nvidia, &x11, &NVIDIA_DEVICES], &manifest, &[]), &["needs libEGL.so.1"]);
    let egl = [("usr/lib/x86_64-linux-gnu/libEGL.so.1", "")];
    assert!(cures(&[&of_nvidia, &x11, &egl, &NVIDIA_DEVICES], &[], &[]).is_empty());
    only(&cures(&[&[LOADER, DOCKER], &MESA], &[], &[]), &["sees no GPU: if the machine has one", "--device /dev/dri"]);
}

#[test]
fn a_variable_that_names_no_driver_is_told() {
    let set = |name: &'static str, value: &'static str| [(name, value)];
    let files: &[&[(&str, &str)]] = &[&[LOADER], &MESA];
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        let gone = cures(files, &set(name, "/nowhere.json"), &[]);
        only(&gone, &[name, "names /nowhere.json, which is no driver's manifest"]);
    }
    let manifest = "ROOT/usr/share/vulkan/icd.d/radeon_icd.x86_64.json";
    let dangling = cures(&[&[LOADER], &MESA[..1]], &set("VK_DRIVER_FILES", manifest), &[]);
    only(&dangling, &["libvulkan_radeon.so is not there"]);
    let empty = cures(&[&[LOADER, ("empty/x.txt", "")]], &set("VK_DRIVER_FILES", "ROOT/empty"), &[]);
    only(&empty, &["names no manifest"]);
    // A folder stands for all manifests in it.
    let relative = ("drivers/mine.json", r#"{"ICD": {"library_path": "./libmine.so"}}"#);
    let whole = [LOADER, relative, ("drivers/libmine.so", "")];
    assert!(cures(&[&whole], &set("VK_DRIVER_FILES", "ROOT/drivers"), &[]).is_empty());
    let more = [("ld/libvulkan.so.1", "")];
    assert!(cures(&[&more], &set("LD_LIBRARY_PATH", "ROOT/ld"), &[]).is_empty());
}

#[test]
fn facts_say_what_there_is() {
    let files = [&[LOADER, NVIDIA, DOCKER][..], &NVIDIA_DEVICES].concat();
    let variables = &[("NVIDIA_DRIVER_CAPABILITIES", "compute")];
    let (_root, found) = System { files: &files, variables, closed: &["nvidia0"] }.look();
    let facts = found.facts().join("\n");
    for fact in [
        "libvulkan.so.1, the loader of Vulkan: found",
        "etc/vulkan/icd.d/nvidia_icd.json: library libGLX_nvidia.so.0, not found",
        "device /dev/nvidia0: cannot be opened",
        "device /dev/nvidiactl: can be opened",
        "container: docker",
        "NVIDIA_DRIVER_CAPABILITIES=compute",
    ] {
        assert!(facts.contains(fact), "{facts}\nhas no {fact}");
    }
    let (_root, none) = System { files: &[], variables: &[], closed: &[] }.look();
    let facts = none.facts().join("\n");
    assert_has(&facts, &["not found", "none found", "none"]);
}
