// diagnose, first: momentum sum of m_c v_c, kinetic energy sum of m_c |v_c|^2 / 2, and the largest magnitude of a
// face velocity. v_c: mean of opposite faces; m_c: rho times the liquid volume of the cell.
// One thread per share of the band; each sums every n-th quad.
// level, step. band_args, band_list: the band. velocity: faces, m/s. liquid_distance, solid_distance: m. partials:
// momentum (kg m/s), kinetic energy (J). maxima: bits of the largest speed (m/s) first.
#import dispatch
#import layout
#import lanes
#import filled
#import real

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> partials: array<Real4>;
@group(0) @binding(8) var<storage, read_write> maxima: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn measure_motion(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let thread = linear_index(workgroup, lane);
    let n_threads = arrayLength(&partials);
    if thread >= n_threads {
        return;
    }
    var sums = Real4();
    // As bits: they are ordered like the magnitudes, with NaN above all.
    var fastest = vec4<u32>();
    for (var index = thread; index < band_args[3]; index += n_threads) {
        let quad = band_list[index];
        let y = level.quads + quad;
        let z = 2u * level.quads + quad;
        let u = velocity[quad];
        let v = velocity[y];
        let w = velocity[z];
        fastest = max(max(fastest, bitcast<vec4<u32>>(abs(u))), max(bitcast<vec4<u32>>(abs(v)), bitcast<vec4<u32>>(abs(w))));
        let phi = liquid_distance[quad];
        if all(phi >= vec4<f32>(0.5 * step.dx)) {
            continue;
        }
        let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
        let mass = select(Real4(), liquid_volume(quad, phi), exists);
        // Twice the velocity at the centres.
        let cu = Real4(u) + Real4(shift_down(u, velocity[quad + 1u]));
        let cv = Real4(v) + Real4(velocity[y + level.stride_y]);
        let cw = Real4(w) + Real4(velocity[z + level.stride_z]);
        sums += Real4(dot(mass, cu), dot(mass, cv), dot(mass, cw), dot(mass, cu * cu + cv * cv + cw * cw));
    }
    let dx = Real(step.dx);
    let cell_mass = Real(step.density) * dx * dx * dx;
    let half = Real(0.5);
    partials[thread] = sums * cell_mass * Real4(half, half, half, half * half * half);
    atomicMax(&maxima[0], max(max(fastest.x, fastest.y), max(fastest.z, fastest.w)));
}
