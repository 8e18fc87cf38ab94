// excess, last: e from the smoothed numbers, in liquid of components with a surface, less a dead band, and less where it takes the volume
// further from its target. One thread per quad of the band.
// band_args, band_list: the band. component: labels. component_sums: volumes, with the mark of a surface. component_volume: targets, volumes of a cell.
// liquid_distance: m. density_now: (F - 1) w and w, smoothed. excess: e; out. level_step: parameters of the sub-step.
#import component_sums
#import controlled_part
#import dispatch

@group(0) @binding(0) var<uniform> level_step: LevelStep;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> component_sums: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> component_volume: array<f32>;
@group(0) @binding(6) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> density_now: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read_write> excess: array<vec4<f32>>;

// The constants of reference/excess.rs, and the dead band of reference/volume_shift.rs.
const LEAST_WEIGHT = 0.05;
const DEAD_BAND = 0.06;
const VOLUME_BAND = 0.005;

// Part of e that acts on a component.
fn part_of(label: u32, e: f32) -> f32 {
    let volume = volume_of(component_sums[label]);
    let goal = component_volume[label];
    let lacks = goal - volume;
    var against = 0.0;
    if e * lacks < 0.0 {
        against = abs(lacks) / (VOLUME_BAND * abs(goal));
    }
    return controlled_part(volume) * max(1.0 - against, 0.0);
}

@compute @workgroup_size(WG_SIZE)
fn limit_excess(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let label = component[quad];
    let liquid = liquid_distance[quad] < vec4<f32>();
    var e = vec4<f32>();
    for (var l = 0u; l < 4u; l++) {
        let density = density_now[4u * quad + l];
        if label[l] == 0u || !liquid[l] || density.y <= LEAST_WEIGHT || (component_sums[label[l]].y & SURFACE) == 0u {
            continue;
        }
        let mean = density.x / density.y;
        e[l] = part_of(label[l], mean) * sign(mean) * max(abs(mean) - DEAD_BAND, 0.0);
    }
    excess[quad] = e;
}
