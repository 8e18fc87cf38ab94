//! The validation layer of Khronos has nothing to say of a whole run: every call that wgpu makes of Vulkan for our kernels, buffers,
//! read-backs and waits is right, and nothing is read while it is written.
#![cfg(target_os = "linux")]

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::gpu;

/// Asks the layer for advice on what is merely not best.
const ADVICE: &str = "khronos_validation.enables = VK_VALIDATION_FEATURE_ENABLE_BEST_PRACTICES_EXT\n";

/// What the layer says of a command of cutwater; wgpu always has it watch for races, too.
fn said(arguments: &str, settings: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let (log, file) = (folder.path().join("log.txt"), folder.path().join("vk_layer_settings.txt"));
    let settings = format!(
        "khronos_validation.debug_action = VK_DBG_LAYER_ACTION_LOG_MSG\n\
         khronos_validation.report_flags = error,warn,perf\n\
         khronos_validation.log_filename = {}\n{settings}",
        log.display()
    );
    fs::write(&file, settings).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_cutwater"));
    command
        .args(arguments.split_whitespace())
        .arg("--adapter")
        .arg(&gpu().unwrap().report().name)
        .current_dir(&folder)
        .env("WGPU_VALIDATION", "1")
        .env("VK_LAYER_SETTINGS_PATH", &file);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}\n{}", String::from_utf8_lossy(&output.stderr));
    fs::read_to_string(log).unwrap_or_default()
}

/// That the layer is there and would be heard: asked for advice it speaks. `REQUIRE_VALIDATION=1` makes a missing layer a failure.
fn is_heard(scene: &str) -> bool {
    let advice = said(&format!("plan {scene}"), ADVICE);
    let heard = advice.contains("BestPractices");
    let required = std::env::var("REQUIRE_VALIDATION").is_ok_and(|value| value == "1");
    assert!(heard || !required, "REQUIRE_VALIDATION=1 and no VK_LAYER_KHRONOS_validation: {advice:?}");
    if !heard {
        eprintln!("skipped for want of VK_LAYER_KHRONOS_validation (Debian: vulkan-validationlayers)");
    }
    heard
}

#[test]
fn it_is_silent_over_a_run() {
    let Some(_) = gpu() else { return };
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/dam_break.toml");
    let scene = format!("{} --scale 0.25 --set output.fields=true", scene.display());
    if is_heard(&scene) {
        let messages = said(&format!("run {scene} --frames 3 --out run"), "");
        assert!(messages.is_empty(), "{messages}");
    }
}
