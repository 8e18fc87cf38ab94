// diagnose, for solids, first of two: the largest rate at which nodes close gaps (twin: Contacts::closing_rate), and
// sums over nodes of momentum m v, angular momentum m x cross v about the origin,
// kinetic energy m |v|^2 / 2 and potential energy - m g . x. Elastic energy and determinants of the elements come
// from solid_matrices.
// One thread per share of both; each sums every n-th node, then every n-th element.
// step. rest: m, kg. displacement: larger parts, then smaller, m. velocity: m/s. rotated: determinants in the third
// section. element_forces: energies (J) in the first. gaps: see contact. partials: three sections of sums. extremes: see extremes.
#import contact
#import dispatch
#import extremes
#import pair
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> velocity: array<Real4>;
@group(0) @binding(4) var<storage, read> rotated: array<Real4>;
@group(0) @binding(5) var<storage, read> element_forces: array<Real4>;
@group(0) @binding(6) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> partials: array<Real4>;
@group(0) @binding(8) var<storage, read_write> extremes: array<atomic<u32>>;

fn closing_rate(node: u32, v: Real3) -> f32 {
    let skin = SKIN * step.dx;
    let walls = gaps[node];
    let of_walls = closing_rate_of_walls(walls, v, skin);
    let n_gaps = arrayLength(&gaps);
    if n_gaps == step.n_nodes {
        return of_walls;
    }
    var rate = 0.0;
    if n_gaps > 2u * step.n_nodes {
        rate = gaps[2u * step.n_nodes + node].x;
    }
    return max(of_walls, closing_rate_of_obstacle(walls, gaps[step.n_nodes + node], rate, v, step.dt, skin));
}

@compute @workgroup_size(WG_SIZE)
fn measure_solid(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let thread = linear_index(workgroup, lane);
    let n_threads = arrayLength(&partials) / 3u;
    if thread >= n_threads {
        return;
    }
    let half = Real(0.5);
    var motion = Real4();
    var turning = Real4();
    var potential = Real();
    // As bits: they are ordered like the magnitudes, with NaN above all.
    var fastest = vec3<u32>();
    var closing = 0u;
    for (var node = thread; node < step.n_nodes; node += n_threads) {
        let here = rest[node];
        let u = Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
        let x = Real3(here.xyz) + pair_value(u);
        let v = velocity[node].xyz;
        let mass = Real(here.w);
        motion += mass * Real4(v, half * dot(v, v));
        turning += mass * Real4(cross(x, v), Real());
        potential -= mass * dot(Real3(step.gravity), x);
        fastest = max(fastest, bitcast<vec3<u32>>(abs(vec3<f32>(v))));
        closing = max(closing, bitcast<u32>(abs(closing_rate(node, v))));
    }
    var worst = 0u;
    var inverted = 0u;
    for (var element = thread; element < step.n_elements; element += n_threads) {
        let determinant = rotated[2u * step.n_elements + element].w;
        turning.w += element_forces[element].w;
        worst = max(worst, smallness(f32(determinant)));
        inverted += u32(determinant <= Real());
    }
    partials[thread] = motion;
    partials[n_threads + thread] = turning;
    partials[2u * n_threads + thread] = Real4(potential, Real(), Real(), Real());
    atomicMax(&extremes[FASTEST], max(max(fastest.x, fastest.y), fastest.z));
    atomicMax(&extremes[CLOSING], closing);
    atomicMax(&extremes[WORST], worst);
    atomicAdd(&extremes[N_INVERTED], inverted);
}
