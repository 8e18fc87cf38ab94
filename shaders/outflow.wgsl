// advect_level with open sides: volumes that leave through them, dt A max(u_n, 0) clamp(1/2 - phi, 0, 1) with the level before
// the sub-step (equation in the twin, reference/level_exchange.rs). One thread per face of an open side.
// step. outlet_cells, outlet_faces: cells and faces, the latter with a bit on plus sides. velocity: faces before the sub-step,
// m/s. open: face apertures. liquid_distance: before the sub-step, m. component: labels before it. component_removed: see
// removed. exchange_totals: see exchange_totals.
#import dispatch
#import filled_part
#import removed
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> outlet_cells: array<u32>;
@group(0) @binding(2) var<storage, read> outlet_faces: array<u32>;
@group(0) @binding(3) var<storage, read> velocity: array<f32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(6) var<storage, read> component: array<u32>;
@group(0) @binding(7) var<storage, read_write> component_removed: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> exchange_totals: array<atomic<u32>>;

// Bit of a face on a plus side.
const PLUS_SIDE = 0x80000000u;

@compute @workgroup_size(WG_SIZE)
fn outflow(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&outlet_cells) {
        return;
    }
    let cell = outlet_cells[index];
    let face = outlet_faces[index] & ~PLUS_SIDE;
    let speed = select(-velocity[face], velocity[face], (outlet_faces[index] & PLUS_SIDE) != 0u);
    let filled = filled_part(liquid_distance[cell] / step.dx);
    let volume = step.dt * step.inv_dx * open[face] * max(speed, 0.0) * filled;
    remove_volume(component[cell], LEFT_VOLUME, volume);
}
