// Jacobi preconditioner of the two-field system, for comparison, set-up: inverses of the blocks of the nodes on the diagonal of
// A22 = Z2 + Z2 Z1^-1 Z2, over the mass rate of a cell, or of their diagonals alone. One thread per slot of the rows.
// coupling, rows. kind: 1 in x for whole blocks. list, blocks: see rows. freedom: see freedom. masses: zeta_M m, kg/s. rotated, incidence: see
// node_block. diagonal: xx, yy, zz, 0, then xy, xz, yz, 0, two sections, out.
#import coupling
#import dispatch
#import inner
#import node_block
#import real
#import rows

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<uniform> rows: Rows;
@group(0) @binding(2) var<uniform> kind: vec4<u32>;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> blocks: array<Inner4>;
@group(0) @binding(5) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> masses: array<Real>;
@group(0) @binding(7) var<storage, read> rotated: array<Real4>;
@group(0) @binding(8) var<storage, read> incidence: array<u32>;
@group(0) @binding(9) var<storage, read_write> diagonal: array<Real4>;

// sum + B P B^T / z1, with the columns of B and the projector P of the node that they belong to.
fn plus_squared(sum: Symmetric, x: Real3, y: Real3, z: Real3, node: u32) -> Symmetric {
    let over_z1 = Real(1.0) / (Real(coupling.share) * masses[node]);
    let free = select(Real3(), Real3(over_z1), free_components(freedom[node]));
    let n = held_along(freedom[node]);
    let columns = plus_outer(plus_outer(plus_outer(sum, free.x, x), free.y, y), free.z, z);
    return plus_outer(columns, -over_z1, x * n.x + y * n.y + z * n.z);
}

@compute @workgroup_size(WG_SIZE)
fn two_field_diagonal(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = linear_index(workgroup, lane);
    if slot >= rows.n_nodes {
        return;
    }
    let node = list[slot];
    let here = node_block(node, rows.n_elements, (Real(1.0) - Real(coupling.share)) * masses[node]);
    let s = here.squares;
    let p = here.products;
    var sum = plus_squared(here, Real3(s.x, p.xy), Real3(p.x, s.y, p.z), Real3(p.yz, s.z), node);
    let slice = rows.slices + slot / SLICE;
    let end = list[slice + 1u];
    for (var entries = list[slice]; entries < end; entries++) {
        let at = entries * 3u * SLICE + slot % SLICE;
        let first = blocks[at];
        let second = Real3(blocks[at + SLICE].xyz);
        sum = plus_squared(sum, Real3(first.xyz), second, Real3(blocks[at + 2u * SLICE].xyz), u32(first.w));
    }
    var kept = kept_block(freedom[node], held_along(freedom[node]), sum);
    if kind.x == 0u {
        kept.products = Real3();
    }
    let inverse = inverse_of(kept);
    let mass = Real(coupling.mass);
    diagonal[node] = Real4(mass * inverse.squares, Real(0.0));
    diagonal[rows.n_nodes + node] = Real4(mass * inverse.products, Real(0.0));
}
