// marker_band, last of four: appends a marker at each site that enters, in the order of the cells, with velocity 0 and no spray: `spray` sets
// both. Seeds beyond the capacity have no slot; in a second run those alone go to the slots that were freed since. One thread per quad of the band.
// level, step. level_step: seed, sub-step, capacity, freed slots. band_args, band_list: the band. seeds: per quad of the list, a bit per site, eight
// per lane. chunks: seeds before each workgroup. report: see report. markers: x, y, z (m), w = 1 alive. marker_velocity: m/s, w = 1 for spray.
#import dispatch
#import layout
#import step
#import sites
#import seed_slots

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> level_step: LevelStep;
@group(0) @binding(3) var<storage, read> band_args: array<u32>;
@group(0) @binding(4) var<storage, read> band_list: array<u32>;
@group(0) @binding(5) var<storage, read> seeds: array<u32>;
@group(0) @binding(6) var<storage, read> chunks: array<u32>;
@group(0) @binding(7) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> marker_velocity: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> report: array<u32>;

var<workgroup> sh_counts: array<u32, WG_SIZE>;

@compute @workgroup_size(WG_SIZE)
fn seed_band(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var sites = 0u;
    if index < band_args[3] {
        sites = seeds[index];
    }
    sh_counts[lane] = countOneBits(sites);
    workgroupBarrier();
    if sites == 0u {
        return;
    }
    var slot = first_seed() + chunks[group_index(workgroup)];
    for (var before = 0u; before < lane; before++) {
        slot += sh_counts[before];
    }
    let first = vec3<u32>(quad_cell(level, band_list[index]));
    let freed = level_step.freed;
    while sites != 0u {
        let bit = firstTrailingBit(sites);
        sites &= sites - 1u;
        let own = slot - freed;
        let writes = (slot < level_step.capacity) == (freed == 0u);
        slot++;
        if !writes {
            continue;
        }
        let cell = first + vec3<u32>(bit / SITES, 0u, 0u);
        let at = site(cell, hash_of_cell(cell), bit % SITES);
        markers[own] = vec4<f32>(at * step.dx, 1.0);
        marker_velocity[own] = vec4<f32>();
    }
}
