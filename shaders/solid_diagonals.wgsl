// right_hand_side, for solids, last part: the mass term of S and the inverse of its 3x3 blocks on the diagonal, D_i = zeta_M m_i I + sum zeta_K K_aa over the
// elements of the node; what is not free is left out and zero in the inverse. One thread per node.
// step, rows. freedom: see freedom. rest: position and mass, kg. load: the fourth number is tau_M, 1/s. rotated: see solid_blocks.
// incidence: see gather. masses: zeta_M m, then the mean of the diagonal of D_i, kg/s, two sections, out. inverse: s/kg, xx, yy, zz with zeta_M m as fourth number, then
// xy, xz, yz, then the direction along which an obstacle holds the node, three sections, out.
#import dispatch
#import freedom
#import inner
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
    // xx, yy, zz and xy, xz, yz.
    var squares = Real3(mass);
    var products = Real3();
    let last = incidence[node + 1u];
    for (var at = incidence[node]; at < last; at++) {
        let element = incidence[at] / 4u;
        let corner = incidence[at] % 4u;
        let first = rotated[element];
        let second = rotated[rows.n_elements + element];
        var g = -(first.xyz + second.xyz + rotated[2u * rows.n_elements + element].xyz);
        if corner > 0u {
            g = rotated[(corner - 1u) * rows.n_elements + element].xyz;
        }
        let both = first.w + second.w;
        squares += both * (g * g) + Real3(second.w * dot(g, g));
        products += both * (g.xxy * g.yzz);
    }
    let mean = (squares.x + squares.y + squares.z) / Real(3.0);
    masses[rows.n_nodes + node] = mean;
    let free = free_components(freedom[node]);
    products = select(Real3(), products, free.xxy & free.yzz);
    // Along n, a unit vector or 0, D becomes the mean and couples with nothing.
    let along = Real3(freedom[node].xyz);
    let n = along / sqrt(max(dot(along, along), Real(0.5)));
    let dn = Real3(
        squares.x * n.x + products.x * n.y + products.y * n.z,
        products.x * n.x + squares.y * n.y + products.z * n.z,
        products.y * n.x + products.z * n.y + squares.z * n.z,
    );
    let both = dot(n, dn) + mean;
    squares += n * (both * n - Real(2.0) * dn);
    products += both * (n.xxy * n.yzz) - (dn.xxy * n.yzz + n.xxy * dn.yzz);
    // D = L diag(pivots) L^T: no difference of nearly equal products.
    let pivot_x = squares.x;
    let yx = products.x / pivot_x;
    let zx = products.y / pivot_x;
    let pivot_y = squares.y - yx * products.x;
    let zy = (products.z - yx * products.y) / pivot_y;
    let pivot_z = squares.z - zx * products.y - zy * (products.z - yx * products.y);
    // L^-1 has -yx, -zy and this below its diagonal.
    let corner = yx * zy - zx;
    let i = Real3(Real(1.0)) / Real3(pivot_x, pivot_y, pivot_z);
    let diagonal = Real3(i.x + yx * yx * i.y + corner * corner * i.z, i.y + zy * zy * i.z, i.z);
    let others = Real3(-yx * i.y - corner * zy * i.z, corner * i.z, -zy * i.z);
    let held = n / mean;
    inverse[node] = Inner4(Inner3(select(Real3(), diagonal - held * n, free)), Inner(mass));
    inverse[rows.n_nodes + node] = Inner4(Inner3(others - held.xxy * n.yzz), Inner(0.0));
    inverse[2u * rows.n_nodes + node] = Inner4(Inner3(n), Inner(0.0));
}
