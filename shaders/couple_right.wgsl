// Two-field preconditioner, in the wet quads: the right-hand side of the V-cycle is g_p + J t with t = Sh g_v; the first sweep is done
// again. g_p is kept.
// coupling, words, quad_pairs, flags: see coupling_flux. level: level 0. sweep: first omega. x: t, times the mass rate of a cell. matrix: see
// level. r: g_p in, the right-hand side out. z: first sweep, out. kept: g_p, out.
#import coupling_flux
#import dispatch
#import inner
#import level
#import real
#import sweep

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<uniform> level: Level;
@group(0) @binding(2) var<uniform> sweep: Sweep;
@group(0) @binding(3) var<storage, read> words: array<u32>;
@group(0) @binding(4) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> flags: array<u32>;
@group(0) @binding(6) var<storage, read> x: array<Real4>;
@group(0) @binding(7) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(8) var<storage, read_write> r: array<Inner4>;
@group(0) @binding(9) var<storage, read_write> z: array<Inner4>;
@group(0) @binding(10) var<storage, read_write> kept: array<Inner4>;

@compute @workgroup_size(WG_SIZE)
fn couple_right(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let before = r[quad];
    let after = before + Inner4(Real(coupling.mass) * flux(wet));
    kept[wet] = before;
    r[quad] = after;
    z[quad] = Inner(sweep.omega) * matrix[INV_DIAGONAL * level.shape.total + quad] * after;
}
