// Jacobi preconditioner of the two-field system, in the wet quads, after pcg_jacobi: the diagonal of J Z1^-1 J^T joins that of B, and r . z is
// corrected by what it had instead.
// coupling, words, quad_pairs: see coupling_flux. level: level 0. freedom: see freedom. masses: zeta_M m, kg/s. matrix: see level; 0 in inactive
// lanes. r: in. z: in place. partials: those of the wet quads, then of the nodes.
#import coupling
#import dispatch
#import freedom
#import inner
#import level
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<uniform> level: Level;
@group(0) @binding(2) var<storage, read> words: array<u32>;
@group(0) @binding(3) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> masses: array<Real>;
@group(0) @binding(6) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(7) var<storage, read> r: array<Inner4>;
@group(0) @binding(8) var<storage, read_write> z: array<Inner4>;
@group(0) @binding(9) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_jacobi(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    var added = Real4();
    let last = words[coupling.quad_starts + wet + 1u];
    for (var at = words[coupling.quad_starts + wet]; at < last; at++) {
        let pair = quad_pairs[at];
        let node = pair.w / 4u;
        let value = Real3(bitcast<vec3<f32>>(pair.xyz));
        added[pair.w % 4u] += dot(value, free_part(freedom[node], value)) / masses[node];
    }
    added *= Real(coupling.mass) / Real(coupling.share);
    let inverse = Real4(matrix[INV_DIAGONAL * level.shape.total + quad]);
    let before = z[quad];
    let after = Inner4(Real4(r[quad]) * (inverse / (Real4(Real(1.0)) + inverse * added)));
    z[quad] = after;
    // Cells that were active in an earlier solve keep their z.
    let change = select(Real4(), Real4(after) - Real4(before), inverse > Real4());
    partials[wet] = Real4(dot(Real4(r[quad]), change), Real(0.0), Real(0.0), Real(0.0));
}
