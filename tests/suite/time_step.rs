//! Lengths of sub-steps: limits by speed, by acceleration, by the last sub-step and by the frames; the same physics at any frame rate.

use std::fs;

use cutwater::geometry::obstacle_cut;
use cutwater::reference::StepLimits;
use cutwater::scene::{Keyframe, Scene};
use glam::DVec3;

use crate::common::scene_from;

const POOL: &str = "[liquid]\n[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.5, 1] }\n";

/// A unit cube of 10^3 cells, gravity 10 m/s^2, one second in ten frames.
fn scene(rest: &str, overrides: &[&str]) -> Scene {
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [10, 10, 10]\ngravity = [0, -10, 0]\n\
         [time]\nduration = 1.0\nframes_per_second = 10\ncfl = 2\n{rest}"
    );
    scene_from(&text, overrides)
}

fn limits(rest: &str, overrides: &[&str]) -> StepLimits {
    let scene = scene(rest, overrides);
    let cut = obstacle_cut(&scene, &scene.grid()).unwrap();
    StepLimits::new(&scene, cut.accelerations(), None)
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
}

/// 0.9 sqrt(dx / g) = 0.09 s.
#[test]
fn a_surface_in_motion_moves_by_less_than_its_waves_allow() {
    let limits = limits(POOL, &[]);
    let dt = |speed, left, last| limits.time_step(speed, [0.0, left], [last, 0.0]).dt;
    assert!(close(dt(0.0, 0.1, 0.0), 0.1 / 5.0), "a quarter at first");
    assert!(close(dt(0.0, 0.1, 0.02), 0.1 / 4.0), "1.5 times the last");
    assert!(close(dt(0.0, 0.1, 0.1), 0.1 / 2.0));
    assert!(close(dt(0.0, 0.09, 0.1), 0.09), "not shorter than it must");
    assert!(close(dt(0.0, 0.08, 0.04), 0.08), "two parts of a frame grow into one");
    assert!(close(dt(0.0, 0.08, 0.03), 0.04));
    assert!(close(limits.time_step(0.0, [0.0, 0.09], [0.1, 0.0]).wave_cfl, 0.9));
    // 2 cells of 0.1 m at 5 m/s: 0.04 s, three steps to the frame.
    assert!(close(dt(5.0, 0.1, 0.1), 0.1 / 3.0));
    // 4 m/s asks for exactly half the frame; rounding of the time left must not make it three steps.
    assert!(close(dt(4.0, 0.1 + 1e-14, 0.1), 0.05));
}

/// The largest gravity within a sub-step limits it, also one that begins later.
#[test]
fn gravity_over_time_limits_the_sub_steps() {
    let grows = "domain.gravity_keyframes=[{ t = 0.5, gravity = [0, -10, 0] }, { t = 0.51, gravity = [0, 0, 40] }]";
    let limits = limits(POOL, &["without domain.gravity", grows]);
    let dt = |time: f64| limits.time_step(0.0, [time, 0.09], [0.1, 0.0]).dt;
    assert!(close(dt(0.0), 0.09));
    assert!(close(dt(0.45), 0.045), "it grows before the end");
    assert!(close(dt(0.6), 0.045));
    // Volume is controlled over one time all along, by the largest: sqrt(1 m / 40 m/s^2) / 8.
    assert!(close(limits.control_time(0.0), 0.025_f64.sqrt() / 8.0));
}

/// Nothing moves explicitly: only speeds limit, that of a fall over a cell included.
#[test]
fn a_fixed_surface_has_no_such_limit() {
    let limits = limits(POOL, &["liquid.surface=\"fixed\""]);
    let dt = |speed, left, last| limits.time_step(speed, [0.0, left], [last, 0.0]).dt;
    assert!(close(dt(0.0, 0.1, 0.0), 0.1));
    assert!(close(dt(0.0, 1.0, 0.0), 0.2), "2 sqrt(dx / g)");
    assert!(close(dt(0.0, 0.1, 0.01), 0.1 / 7.0));
}

#[test]
fn steps_have_a_least_and_a_largest_length() {
    let limits_of = |overrides: &[&str]| limits(POOL, overrides);
    let floored = limits_of(&[]).time_step(1e9, [0.0, 1e-5], [0.0, 0.0]);
    assert!(floored.floored && close(floored.dt, 1e-7), "{floored:?}");
    assert!(!limits_of(&[]).time_step(5.0, [0.0, 0.1], [0.01, 0.0]).floored);
    let short = limits_of(&["time.max_step=0.01"]);
    assert!(close(short.time_step(0.0, [0.0, 0.1], [1.0, 0.0]).dt, 0.01));
    let fixed = limits_of(&["time.fixed_step=0.02"]);
    assert!(close(fixed.time_step(1e6, [0.0, 0.04 - 1e-14], [1e-9, 0.0]).dt, 0.02));
    // Two cells of 0.1 m in 0.02 s are 10 m/s; a fixed step is not shortened for more, but told.
    assert!(!fixed.time_step(10.0, [0.0, 0.1], [0.0, 0.0]).floored);
    assert!(fixed.time_step(10.1, [0.0, 0.1], [0.0, 0.0]).floored);
    // Contact shortens both, to equal parts of what is left.
    assert!(close(fixed.time_step(0.0, [0.0, 0.04], [0.02, 0.005]).dt, 0.005));
    assert!(close(fixed.time_step(0.0, [0.0, 0.04], [0.02, 0.02]).dt, 0.02));
    assert!(close(short.time_step(0.0, [0.0, 0.1], [0.01, 0.003]).dt, 0.1 / 34.0));
}

/// Volume control works over sqrt(1 m / 10 m/s^2) / 8, or over an eighth of the time that the fastest point takes across.
#[test]
fn volume_is_controlled_over_a_time_of_the_flow() {
    let falling = limits(POOL, &[]);
    assert!(close(falling.control_time(3.0), 0.1_f64.sqrt() / 8.0));
    let floating = limits(POOL, &["domain.gravity=[0,0,0]"]);
    assert!(close(floating.control_time(0.5), 0.25));
    assert_eq!(floating.control_time(0.0), f64::INFINITY);
    assert!(close(floating.time_step(0.0, [0.0, 0.1], [0.0, 0.0]).dt, 0.1));
    assert_eq!(floating.time_step(0.0, [0.0, 0.1], [0.0, 0.0]).wave_cfl, 0.0);
}

/// Moves by 0.4 m from 0.5 s to 0.6 s: 4 m/s from rest in that time, and back to rest.
#[test]
fn accelerations_of_obstacles_count_while_they_last() {
    let pushed = format!(
        "{POOL}[[obstacle]]\nsphere = {{ centre = [0.3, 0.3, 0.5], radius = 0.1 }}\n\
         keyframes = [{{ t = 0.5 }}, {{ t = 0.6, translate = [0.4, 0, 0] }}]\n"
    );
    let limits = limits(&pushed, &[]);
    let at = |time: f64| limits.time_step(0.0, [time, 1.0], [1.0, 0.0]);
    // 0.9 sqrt(dx / a), a = 10 and 40 m/s^2.
    let [slow, fast] = [0.09, 0.045];
    for (time, dt) in [(0.0, slow), (0.4, slow), (0.45, fast), (0.5, fast), (0.505, slow), (0.58, fast), (0.61, slow)] {
        let step = at(time);
        assert!(step.dt <= dt * (1.0 + 1e-9) && step.dt > 0.9 * dt, "{time} s: {step:?}");
        assert!(step.wave_cfl <= 0.9 * (1.0 + 1e-9), "{time} s: {step:?}");
    }
    assert!(close(limits.control_time(0.0), 0.1_f64.sqrt() / 8.0), "that of gravity");
}

#[test]
fn accelerations_of_keyframes_are_changes_of_velocity_and_of_direction() {
    let frame =
        |time: f64, x: f64, angle: f64| Keyframe { time, translate: DVec3::new(x, 0.0, 0.0), axis: DVec3::Z, angle };
    let of = |frames: &[Keyframe]| -> Vec<([f64; 2], f64)> {
        let all = Keyframe::accelerations(frames, 0.5);
        all.iter().map(|of| (of.times, of.size)).collect()
    };
    assert!(of(&[frame(0.0, 1.0, 2.0)]).is_empty());
    // 2 m/s from rest over 1 s, then 5 m/s: over half of 1 s and of 2 s; it stops from 5 m/s over 2 s.
    let pushed = [frame(0.0, 0.0, 0.0), frame(1.0, 2.0, 0.0), frame(3.0, 12.0, 0.0)];
    let expected = [([0.0; 2], 2.0), ([1.0; 2], 2.0), ([3.0; 2], 2.5)];
    assert_eq!(of(&pushed), expected);
    // 8 rad/s at 0.5 m: 32 m/s^2 to the centre, 4 m/s from rest in 1 s and back.
    let turned = [frame(0.0, 0.0, 0.0), frame(1.0, 0.0, 8.0)];
    assert_eq!(of(&turned), [([0.0; 2], 4.0), ([0.0, 1.0], 32.0), ([1.0; 2], 4.0)]);
}

#[test]
fn bad_limits_are_refused() {
    let refused = |overrides: &[&str]| {
        let text = format!(
            "[domain]\nsize = [1, 1, 1]\ncells = [10, 10, 10]\n[time]\nduration = 1.0\nframes_per_second = 10\n{POOL}"
        );
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("test.toml");
        fs::write(&path, text).unwrap();
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        let error = Scene::load(&path, &overrides, 1.0).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    let both = refused(&["time.max_step=0.01", "time.fixed_step=0.02"]);
    assert!(both.contains("time.max_step") && both.contains("time.fixed_step"), "{both}");
    let tiny = refused(&["time.max_step=1e-9"]);
    assert!(tiny.contains("time.max_step") && tiny.contains("use at least"), "{tiny}");
    assert!(refused(&["time.max_step=-1"]).contains("time.max_step"));
}
