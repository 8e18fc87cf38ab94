// volume_shift: moves the level of every component with a surface towards its target (equation in the twin,
// reference/volume_shift.rs). One thread per quad of the band.
// step, level_step. band_args, band_list: the band. component: labels. component_sums: volumes, with the mark of a surface. areas:
// see component_areas. component_volume: targets, volumes of a cell. solid_distance, liquid_distance: m; the latter in place.
#import component_sums
#import dispatch
#import level_step
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> level_step: LevelStep;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> component_sums: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> areas: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read> component_volume: array<f32>;
@group(0) @binding(8) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(9) var<storage, read_write> liquid_distance: array<vec4<f32>>;

// Constants of reference/volume_shift.rs. Part of the target within which nothing moves.
const DEAD_BAND = 0.005;
// Deficit beyond which volume returns at once, over the target.
const ALLOWED_DEFICIT = 0.025;
// Largest shift at once, cells.
const AT_ONCE = 1.0;
// Distance from bodies from which the shift at once is whole, cells.
const BESIDE_BODY = 0.5;
// Least area, cells.
const LEAST_AREA = 1e-6;
// Largest gradual shift inwards over that outwards.
const INWARDS = 0.25;

// Largest gradual shift outwards, cells.
fn largest_shift(courant: f32) -> f32 {
    return min(0.16 * max(courant * courant / 9.0, 1.0), 2.0);
}

// Shift of a component, and what returns at once beyond it, cells.
fn shift_of(label: u32) -> vec2<f32> {
    let volume = component_sums[label];
    let area = value_of(areas[label]);
    if (volume.y & SURFACE) == 0u || area <= LEAST_AREA {
        return vec2<f32>();
    }
    let goal = component_volume[label];
    let lacks = goal - volume_of(volume);
    let moved = sign(lacks) * max(abs(lacks) - DEAD_BAND * abs(goal), 0.0);
    let largest = largest_shift(level_step.courant);
    let in_time = clamp(moved * min(step.dt / step.control_time, 1.0) / area, -INWARDS * largest, largest);
    let beyond = lacks - ALLOWED_DEFICIT * abs(goal);
    return vec2<f32>(in_time, select(0.0, max(min(beyond / area, AT_ONCE) - in_time, 0.0), beyond > 0.0));
}

@compute @workgroup_size(WG_SIZE)
fn volume_shift(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let label = component[quad];
    if all(label == vec4<u32>()) {
        return;
    }
    var phi = liquid_distance[quad];
    var last = 0u;
    var shift = vec2<f32>();
    for (var l = 0u; l < 4u; l++) {
        if label[l] == 0u {
            continue;
        }
        if label[l] != last {
            last = label[l];
            shift = shift_of(last);
        }
        let cell = min(4u * quad + l, arrayLength(&solid_distance) - 1u);
        let part = clamp(step.inv_dx * solid_distance[cell] / BESIDE_BODY, 0.0, 1.0);
        phi[l] -= step.dx * (shift.x + part * shift.y);
    }
    liquid_distance[quad] = phi;
}
