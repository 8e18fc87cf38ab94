// right_hand_side, for solids, last part: the mass term of S and the inverse of its 3x3 blocks on the diagonal, D_i = zeta_M m_i I + sum zeta_K K_aa over the
// elements of the node; what is not free is left out and zero in the inverse. One thread per node.
// step, rows. freedom: see freedom. rest: position and mass, kg. load: the fourth number is tau_M, 1/s. rotated: see solid_blocks.
// incidence: see gather. masses: zeta_M m, then the mean of the diagonal of D_i, kg/s, two sections, out. inverse: s/kg, xx, yy, zz with zeta_M m as fourth number, then
// xy, xz, yz, then the direction along which an obstacle holds the node, three sections, out.
#import dispatch
#import freedom
#import inner
#import node_block
#import real
#import rows
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<uniform> rows: Rows;
@group(0) @binding(2) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> load: array<Real4>;
@group(0) @binding(5) var<storage, read> rotated: array<Real4>;
@group(0) @binding(6) var<storage, read> incidence: array<u32>;
@group(0) @binding(7) var<storage, read_write> masses: array<Real>;
@group(0) @binding(8) var<storage, read_write> inverse: array<Inner4>;

@compute @workgroup_size(WG_SIZE)
fn solid_diagonals(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let mass = (Real(1.0) / Real(step.dt) + Real(step.damped) * load[node].w) * Real(rest[node].w);
    masses[node] = mass;
    let block = node_block(node, rows.n_elements, mass);
    let mean = mean_of(block);
    masses[rows.n_nodes + node] = mean;
    let n = held_along(freedom[node]);
    let inverse_block = inverse_of(kept_block(freedom[node], n, block));
    let held = n / mean;
    inverse[node] = Inner4(Inner3(select(Real3(), inverse_block.squares - held * n, free_components(freedom[node]))), Inner(mass));
    inverse[rows.n_nodes + node] = Inner4(Inner3(inverse_block.products - held.xxy * n.yzz), Inner(0.0));
    inverse[2u * rows.n_nodes + node] = Inner4(Inner3(n), Inner(0.0));
}
