// liquid_distance, at its end: liquid volume V = sum of V_c clamp(1/2 - phi/dx, 0, 1) with V_c the open volume, and
// potential energy - sum of m_c g . x_c with m_c = rho times that volume.
// One thread per share of the band; each sums every n-th quad.
// level, step. band_args, band_list: the band. liquid_distance, solid_distance: m. partials: volume (m^3), potential
// energy (J), 0, 0.
#import dispatch
#import layout
#import lanes
#import filled
#import real

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn measure_volume(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let thread = linear_index(workgroup, lane);
    let n_threads = arrayLength(&partials);
    if thread >= n_threads {
        return;
    }
    var volume = Real();
    var energy = Real();
    for (var index = thread; index < band_args[3]; index += n_threads) {
        let quad = band_list[index];
        let phi = liquid_distance[quad];
        if all(phi >= vec4<f32>(0.5 * step.dx)) {
            continue;
        }
        let cell = quad_cell(level, quad);
        let exists = lanes_inside(cell, vec3<i32>(level.cells));
        let parts = select(Real4(), liquid_volume(quad, phi), exists);
        let sum = (parts.x + parts.y) + (parts.z + parts.w);
        // First moment along x, from the centre of lane 0, cells.
        let moment = parts.y + Real(2.0) * parts.z + Real(3.0) * parts.w;
        let at = vec3<f32>(cell) + 0.5;
        volume += sum;
        energy -= Real(step.gravity.x) * (Real(at.x) * sum + moment)
            + (Real(step.gravity.y) * Real(at.y) + Real(step.gravity.z) * Real(at.z)) * sum;
    }
    let dx = Real(step.dx);
    let cell_volume = dx * dx * dx;
    partials[thread] = Real4(volume * cell_volume, energy * Real(step.density) * cell_volume * dx, Real(), Real());
}
