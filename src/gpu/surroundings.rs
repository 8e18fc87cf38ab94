//! Vulkan diagnostics on Linux: the loader, the driver's manifest, the driver, and access to the device, with cures
//! for missing parts.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Folders of driver manifests, each containing `vulkan/icd.d`.
const MANIFEST_FOLDERS: [&str; 5] = ["etc", "usr/share", "usr/local/share", "usr/local/etc", "run/opengl-driver/share"];
/// Library folders; their folders per machine type are searched too.
const LIBRARY_FOLDERS: [&str; 8] = [
    "lib",
    "lib64",
    "usr/lib",
    "usr/lib64",
    "usr/local/lib",
    "usr/local/lib64",
    "usr/local/nvidia/lib64",
    "run/opengl-driver/lib",
];
const LOADER: &str = "libvulkan.so.1";
/// Libraries that NVIDIA's driver loads even without a display.
const NVIDIA_LIBRARIES: [(&str, &str); 3] =
    [("libX11.so.6", "libx11-6"), ("libXext.so.6", "libxext6"), ("libEGL.so.1", "libegl1")];

/// A driver's manifest.
#[derive(Clone, Debug)]
struct Manifest {
    path: PathBuf,
    /// The library in the manifest, if it is readable.
    library: Option<String>,
}

/// Vulkan diagnostics of a system, from [`Surroundings::look`].
#[derive(Clone, Debug)]
pub struct Surroundings {
    root: PathBuf,
    loader: bool,
    manifests: Vec<Manifest>,
    /// The environment variable that selects the manifests, with its value, if set.
    chosen_by: Option<(&'static str, String)>,
    /// File names of the libraries in the loader's folders.
    libraries: BTreeSet<String>,
    /// GPU device files: name, and whether they can be opened.
    devices: Vec<(String, bool)>,
    /// Kind of container, if any.
    container: Option<&'static str>,
    /// `NVIDIA_DRIVER_CAPABILITIES`, if set.
    capabilities: Option<String>,
}

impl Surroundings {
    /// Diagnostics of this system.
    pub fn of_system() -> Surroundings {
        let open = |path: &Path| File::options().read(true).write(true).open(path).map(|_| ());
        Surroundings::look(Path::new("/"), &|name| std::env::var(name).ok(), &open)
    }

    /// Diagnostics of a system with a root folder and environment variables. `open` tries to open a device file.
    pub fn look(
        root: &Path,
        variable: &dyn Fn(&str) -> Option<String>,
        open: &dyn Fn(&Path) -> io::Result<()>,
    ) -> Surroundings {
        let variable = |name: &str| variable(name).filter(|value| !value.is_empty());
        let chosen_by =
            ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].into_iter().find_map(|name| Some((name, variable(name)?)));
        let paths = match &chosen_by {
            Some((_, files)) => files.split(':').flat_map(|path| manifests(Path::new(path))).collect(),
            None => {
                let mut paths: Vec<PathBuf> = Vec::new();
                let home = |name: &str, below: &str| variable(name).map(|home| PathBuf::from(home).join(below));
                let user_folders = [home("XDG_DATA_HOME", ""), home("HOME", ".local/share")];
                let system_folders = MANIFEST_FOLDERS.iter().map(|folder| root.join(folder));
                for folder in system_folders.chain(user_folders.into_iter().flatten()) {
                    paths.extend(entries(&folder.join("vulkan/icd.d")));
                }
                paths.retain(|path| path.extension().is_some_and(|end| end == "json"));
                paths
            }
        };
        let libraries = libraries(root, variable("LD_LIBRARY_PATH").as_deref());
        let dri = entries(&root.join("dev/dri"));
        let render = dri.into_iter().filter(|path| file_name(path).starts_with("renderD"));
        let others = entries(&root.join("dev")).into_iter().filter(|path| {
            let name = file_name(path);
            name == "nvidiactl" || name == "dxg" || name.strip_prefix("nvidia").is_some_and(is_number)
        });
        let devices = render.chain(others).map(|path| {
            let name = path.strip_prefix(root).unwrap_or(&path);
            (format!("/{}", name.display()), open(&path).is_ok())
        });
        let container = [
            ("apptainer", variable("APPTAINER_NAME").or(variable("SINGULARITY_NAME")).is_some()),
            ("docker", root.join(".dockerenv").exists()),
            ("podman", root.join("run/.containerenv").exists()),
            ("kubernetes", variable("KUBERNETES_SERVICE_HOST").is_some()),
        ];
        Surroundings {
            root: root.to_owned(),
            loader: libraries.contains(LOADER),
            manifests: paths.into_iter().map(Manifest::read).collect(),
            chosen_by,
            devices: devices.collect(),
            libraries,
            container: container.into_iter().find_map(|(name, is)| is.then_some(name)),
            capabilities: variable("NVIDIA_DRIVER_CAPABILITIES"),
        }
    }

    /// The findings, one per line.
    pub fn facts(&self) -> Vec<String> {
        let mut facts = vec![match self.loader {
            true => format!("{LOADER}, the loader of Vulkan: found"),
            false => format!("{LOADER}, the loader of Vulkan: not found"),
        }];
        if let Some((name, value)) = &self.chosen_by {
            facts.push(format!("{name}={value}: other drivers are ignored"));
        }
        if self.manifests.is_empty() {
            facts.push("drivers' manifests: none found".to_owned());
        }
        for manifest in &self.manifests {
            let library = match &manifest.library {
                None => "cannot be read".to_owned(),
                Some(library) if self.has(manifest, library) => format!("library {library}"),
                Some(library) => format!("library {library}, not found"),
            };
            facts.push(format!("driver's manifest {}: {library}", manifest.path.display()));
        }
        for (device, opens) in &self.devices {
            facts.push(format!("device {device}: {}", if *opens { "can be opened" } else { "cannot be opened" }));
        }
        if self.devices.is_empty() {
            facts.push("devices /dev/dri/renderD* or /dev/nvidia*: none".to_owned());
        }
        if let Some(container) = self.container {
            facts.push(format!("container: {container}"));
        }
        if let Some(capabilities) = &self.capabilities {
            facts.push(format!("NVIDIA_DRIVER_CAPABILITIES={capabilities}"));
        }
        facts
    }

    /// Cures for missing adapters, the likeliest first. `hardware`: whether a non-software adapter was found.
    pub fn cures(&self, hardware: bool) -> Vec<String> {
        let mut cures = Vec::new();
        if !self.loader {
            cures.push(format!("install the loader {LOADER} (Debian: apt-get install libvulkan1)"));
        }
        if let Some((name, _)) = &self.chosen_by {
            let wrong =
                |manifest: &&Manifest| manifest.library.as_ref().is_none_or(|library| !self.has(manifest, library));
            match self.manifests.iter().find(wrong) {
                Some(Manifest { path, library: None }) => {
                    cures.push(format!(
                        "{name} names {}, which is no driver's manifest: correct or unset it",
                        path.display()
                    ));
                }
                Some(Manifest { path, library: Some(library) }) => {
                    cures.push(format!(
                        "{name} names {}, whose library {library} is not there: correct or unset it",
                        path.display()
                    ));
                }
                None if self.manifests.is_empty() => {
                    cures.push(format!("{name} names no manifest: correct or unset it"))
                }
                None => {}
            }
        }
        if !hardware {
            self.cures_of_devices(&mut cures);
        }
        cures
    }

    /// Adds cures for GPUs that exist but have no adapter.
    fn cures_of_devices(&self, cures: &mut Vec<String>) {
        let has = |start: &str| self.devices.iter().any(|(name, _)| name.starts_with(start));
        let closed: Vec<&str> =
            self.devices.iter().filter(|(_, opens)| !opens).map(|(name, _)| name.as_str()).collect();
        if !closed.is_empty() {
            let cure = match closed.iter().any(|name| name.starts_with("/dev/dri")) {
                true => "add yourself to its group (usermod -aG render,video USER, then log in again)",
                false => "request read and write access to it",
            };
            cures.push(format!("{} cannot be opened: {cure}", closed.join(", ")));
        }
        let is_nvidia =
            |manifest: &Manifest| manifest.library.as_deref().is_some_and(|library| library.contains("nvidia"));
        let nvidia = self.manifests.iter().find(|manifest| is_nvidia(manifest));
        let driver = nvidia.and_then(|manifest| Some((manifest, manifest.library.as_deref()?)));
        let whole = driver.is_some_and(|(manifest, library)| self.has(manifest, library));
        if has("/dev/nvidia") && self.chosen_by.is_none() {
            let graphics =
                |all: &String| all.split(',').any(|one| ["graphics", "display", "all"].contains(&one.trim()));
            match (self.container, &self.capabilities) {
                (Some("apptainer"), _) if !whole => cures.push(
                    "the NVIDIA GPU has no Vulkan driver: start the container with --nv, and bind the host's \
                     /usr/share/vulkan/icd.d/nvidia_icd.json (or /etc/vulkan/icd.d)"
                        .to_owned(),
                ),
                (_, capabilities) if !whole && (self.container.is_some() || capabilities.is_some()) => {
                    let given = match capabilities {
                        Some(capabilities) if !graphics(capabilities) => format!(" (now {capabilities})"),
                        _ => String::new(),
                    };
                    cures.push(format!(
                        "the NVIDIA GPU has no Vulkan driver: start the container with --gpus all and \
                         NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics{given}: without graphics the toolkit omits Vulkan"
                    ));
                }
                _ if !whole => cures.push(
                    "the NVIDIA GPU has no Vulkan driver: install the part with libGLX_nvidia.so.0 of the driver's \
                     version (Debian: nvidia-vulkan-icd; Ubuntu: libnvidia-gl-VERSION); compute-only drivers lack it"
                        .to_owned(),
                ),
                _ => {}
            }
        }
        let missing = NVIDIA_LIBRARIES.into_iter().filter(|(library, _)| !self.libraries.contains(*library));
        let (libraries, packages): (Vec<&str>, Vec<&str>) = missing.unzip();
        if has("/dev/nvidia") && whole && !packages.is_empty() {
            cures.push(format!(
                "NVIDIA's driver needs {} even without a display (Debian: apt-get install {})",
                libraries.join(" and "),
                packages.join(" ")
            ));
        }
        if has("/dev/dri/renderD") && !has("/dev/nvidia") && self.manifests.is_empty() && self.chosen_by.is_none() {
            cures.push(
                "the GPU has no Vulkan driver (Debian, AMD and Intel: apt-get install mesa-vulkan-drivers)".to_owned(),
            );
        }
        if self.devices.is_empty() && self.container.is_some() {
            cures.push(
                "the container sees no GPU: if the machine has one, start it with --gpus all (NVIDIA) or --device /dev/dri (AMD, Intel)".to_owned(),
            );
        }
    }

    fn has(&self, manifest: &Manifest, library: &str) -> bool {
        match (library.strip_prefix('/'), library.contains('/')) {
            (Some(path), _) => self.root.join(path).exists(),
            // Relative to the manifest's own folder.
            (None, true) => {
                let folder = manifest.path.parent().unwrap_or(Path::new(""));
                folder.join(library).exists()
            }
            (None, false) => self.libraries.contains(library),
        }
    }
}

impl Manifest {
    fn read(path: PathBuf) -> Manifest {
        let text = fs::read_to_string(&path).unwrap_or_default();
        let json: Option<serde_json::Value> = serde_json::from_str(&text).ok();
        let library = json.and_then(|json| Some(json.get("ICD")?.get("library_path")?.as_str()?.to_owned()));
        Manifest { path, library }
    }
}

/// A manifest, or the manifests in a folder.
fn manifests(path: &Path) -> Vec<PathBuf> {
    match path.is_dir() {
        true => entries(path).into_iter().filter(|path| path.extension().is_some_and(|end| end == "json")).collect(),
        false => vec![path.to_owned()],
    }
}

/// Names of the libraries in the usual folders of the dynamic loader.
fn libraries(root: &Path, more: Option<&str>) -> BTreeSet<String> {
    let mut folders: Vec<PathBuf> = LIBRARY_FOLDERS.iter().map(|folder| root.join(folder)).collect();
    for folder in folders.clone() {
        let per_machine = |path: &PathBuf| file_name(path).contains("-linux-") && path.is_dir();
        folders.extend(entries(&folder).into_iter().filter(per_machine));
    }
    folders
        .extend(more.into_iter().flat_map(|more| more.split(':')).filter(|part| !part.is_empty()).map(PathBuf::from));
    for list in entries(&root.join("etc/ld.so.conf.d")) {
        let text = fs::read_to_string(list).unwrap_or_default();
        let lines = text.lines().filter_map(|line| line.trim().strip_prefix('/'));
        folders.extend(lines.map(|line| root.join(line)));
    }
    let paths = folders.iter().flat_map(|folder| entries(folder));
    paths.map(|path| file_name(&path)).filter(|name| name.contains(".so")).collect()
}

/// Entries of a folder, sorted; none if it is unreadable.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    paths
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}
