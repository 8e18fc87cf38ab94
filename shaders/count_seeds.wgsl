// marker_band, second of four: the sites that enter the band, where phi* < -3 <= phi, outside bodies, with phi* the level after its transport
// and phi the one after all changes. One thread per quad of the band.
// level, step. level_step: seed and sub-step. band_args, band_list: the band. carried_level: phi*, cell centres, cells. liquid_distance: dx phi,
// m. solid_distance: m; one quad in a scene without bodies. seeds: per quad of the list, a bit per site, eight per lane. chunks: their number per
// workgroup.
#import corner
#import dispatch
#import layout
#import lanes
#import step
#import sites
#import marker_depth

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> level_step: LevelStep;
@group(0) @binding(3) var<storage, read> band_args: array<u32>;
@group(0) @binding(4) var<storage, read> band_list: array<u32>;
@group(0) @binding(5) var<storage, read> carried_level: array<f32>;
@group(0) @binding(6) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(7) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(8) var<storage, read_write> seeds: array<u32>;
@group(0) @binding(9) var<storage, read_write> chunks: array<u32>;

// Levels of the cells that may contain such a site, cells: the level of a cell is within two cells of that of its sites.
const LOWEST = -5.0;
const HIGHEST = -1.0;

var<workgroup> sh_seeds: atomic<u32>;

fn carried_at(place: Corner) -> f32 {
    let points = corner_points(place);
    let at = points[0];
    let next = points[1];
    let minus = vec4<f32>(carried_level[at.x], carried_level[at.y], carried_level[at.z], carried_level[at.w]);
    let plus = vec4<f32>(carried_level[next.x], carried_level[next.y], carried_level[next.z], carried_level[next.w]);
    return mix_points(minus, plus, place.f);
}

// Whether a place is outside bodies.
fn is_free(place: Corner) -> bool {
    if arrayLength(&solid_distance) <= 4u {
        return true;
    }
    let points = corner_points(place);
    let at = points[0];
    let next = points[1];
    let minus = vec4<f32>(solid_distance[at.x], solid_distance[at.y], solid_distance[at.z], solid_distance[at.w]);
    let plus = vec4<f32>(solid_distance[next.x], solid_distance[next.y], solid_distance[next.z], solid_distance[next.w]);
    return mix_points(minus, plus, place.f) >= 0.0;
}

// The sites of a cell that enter, as bits.
fn entering_of(cell: vec3<u32>) -> u32 {
    let of_cell = hash_of_cell(cell);
    var sites = 0u;
    for (var number = 0u; number < SITES; number++) {
        let place = centres_around(site(cell, of_cell, number));
        let enters = carried_at(place) < -MARKER_DEPTH && level_at(place) >= -MARKER_DEPTH && is_free(place);
        sites |= u32(enters) << number;
    }
    return sites;
}

// The sites of a quad that enter.
fn entering(quad: u32) -> u32 {
    let first = quad_cell(level, quad);
    let inside = lane_bits(lanes_inside(first, vec3<i32>(level.cells)));
    var sites = 0u;
    for (var l = 0u; l < 4u; l++) {
        if (inside >> l & 1u) == 0u {
            continue;
        }
        let now = step.inv_dx * liquid_distance[4u * quad + l];
        if now >= LOWEST && min(carried_level[4u * quad + l], now) <= HIGHEST {
            sites |= entering_of(vec3<u32>(first) + vec3<u32>(l, 0u, 0u)) << (SITES * l);
        }
    }
    return sites;
}

@compute @workgroup_size(WG_SIZE)
fn count_seeds(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var sites = 0u;
    if index < band_args[3] {
        sites = entering(band_list[index]);
        seeds[index] = sites;
    }
    atomicAdd(&sh_seeds, countOneBits(sites));
    workgroupBarrier();
    if lane == 0u && index < band_args[3] {
        chunks[group_index(workgroup)] = atomicLoad(&sh_seeds);
    }
}
