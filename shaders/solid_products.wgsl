// zeta_K K_e x of the elements, N, from differences of x, so that a translation gives exactly 0:
//   H = sum_{a=1..3} (x_a - x_0) g_a^T,  product at corner a = zeta_K V (lambda tr(H) I + mu (H + H^T)) g_a
// Dispatched with a thread per node; each takes every so many-th element.
// rows. elements: their nodes. rotated: see solid_blocks. x: m/s per node. products: at corners 1, 2, 3, three sections, out.
#import dispatch
#import real
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> elements: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> rotated: array<Real4>;
@group(0) @binding(3) var<storage, read> x: array<Real4>;
@group(0) @binding(4) var<storage, read_write> products: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_products(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let thread = linear_index(workgroup, lane);
    let n_threads = (rows.n_nodes + WG_SIZE - 1u) / WG_SIZE * WG_SIZE;
    if thread >= n_threads {
        return;
    }
    let m = rows.n_elements;
    for (var element = thread; element < m; element += n_threads) {
        let nodes = elements[element];
        let origin = x[nodes.x].xyz;
        let x1 = x[nodes.y].xyz - origin;
        let x2 = x[nodes.z].xyz - origin;
        let x3 = x[nodes.w].xyz - origin;
        let first = rotated[element];
        let second = rotated[m + element];
        let g1 = first.xyz;
        let g2 = second.xyz;
        let g3 = rotated[2u * m + element].xyz;
        let trace = dot(x1, g1) + dot(x2, g2) + dot(x3, g3);
        // Columns of H, and of the symmetric stress.
        let hx = x1 * g1.x + x2 * g2.x + x3 * g3.x;
        let hy = x1 * g1.y + x2 * g2.y + x3 * g3.y;
        let hz = x1 * g1.z + x2 * g2.z + x3 * g3.z;
        let mu = second.w;
        let squares = Real3(first.w * trace) + Real(2.0) * mu * Real3(hx.x, hy.y, hz.z);
        let others = mu * Real3(hy.x + hx.y, hz.x + hx.z, hz.y + hy.z);
        let sx = Real3(squares.x, others.x, others.y);
        let sy = Real3(others.x, squares.y, others.z);
        let sz = Real3(others.y, others.z, squares.z);
        products[element] = Real4(sx * g1.x + sy * g1.y + sz * g1.z, Real(0.0));
        products[m + element] = Real4(sx * g2.x + sy * g2.y + sz * g2.z, Real(0.0));
        products[2u * m + element] = Real4(sx * g3.x + sy * g3.y + sz * g3.z, Real(0.0));
    }
}
