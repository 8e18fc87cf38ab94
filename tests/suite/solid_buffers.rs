//! The buffers of the solids hold what they were given.

use cutwater::gpu::BufferPlan;
use cutwater::scene::ElasticModel;

use crate::common::{Random, gpu};
use crate::solid_case::{SolidCase, cases, eps};

#[test]
fn states_come_back_bit_for_bit() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        for real in SolidCase::reals(gpu) {
            let buffers = case.upload(gpu, real);
            let mut state = case.state();
            buffers.read_state(gpu, &mut state).unwrap();
            assert_eq!(state.displacement, case.displacement, "{}", case.name);
            assert_eq!(state.node_velocity, case.velocity, "{}", case.name);
            let words = gpu.download(&buffers.displacement).unwrap();
            buffers.write_state(gpu, &state);
            let again = gpu.download(&buffers.displacement).unwrap();
            assert_eq!(words, again, "{}: both parts", case.name);
        }
    }
}

#[test]
fn constants_are_where_kernels_look() {
    let Some(gpu) = gpu() else { return };
    let mut case = cases().swap_remove(3);
    let mut random = Random(3);
    for load in &mut case.solids.load {
        *load = std::array::from_fn(|_| random.uniform(-9.0, 9.0)).into();
    }
    let solids = &case.solids;
    for real in SolidCase::reals(gpu) {
        let buffers = case.upload(gpu, real);
        let near = |found: f64, wanted: f64| {
            assert!(
                (found - wanted).abs() <= wanted.abs() * eps(real),
                "{found} for {wanted}"
            );
        };
        let rest = gpu.download(&buffers.rest).unwrap();
        let flags = gpu.download(&buffers.flags).unwrap();
        let load = buffers.load.download(gpu).unwrap();
        for body in &solids.bodies {
            for node in body.nodes.clone() {
                let expected = solids.rest[node].extend(solids.mass[node]).as_vec4();
                assert_eq!(rest[node], expected.to_array());
                assert_eq!(flags[node], 7);
                let expected = solids.load[node].extend(body.mass_damping);
                (0..4).for_each(|c| near(load[4 * node + c], expected[c]));
            }
        }
        assert!(flags.len().is_multiple_of(4), "flags in fours");
        assert!(flags[rest.len()..].iter().all(|&flags| flags == 0));
        let elements = gpu.download(&buffers.elements).unwrap();
        assert_eq!(elements, solids.elements);
        let gradients = buffers.rest_gradients.download(gpu).unwrap();
        let damping = gpu.download(&buffers.damping).unwrap();
        for body in &solids.bodies {
            let linear = body.model == ElasticModel::Linear;
            for element in body.elements.clone() {
                let fourth = [solids.volume[element], body.lambda, body.mu];
                for section in 0..3 {
                    let expected = solids.gradients[element][section + 1].extend(fourth[section]);
                    let found = &gradients[4 * (section * elements.len() + element)..];
                    (0..4).for_each(|c| near(found[c], expected[c]));
                }
                let expected = [body.stiffness_damping as f32, f32::from(u8::from(linear))];
                assert_eq!(damping[element], expected);
            }
        }
    }
}

#[test]
fn all_that_is_allocated_is_planned() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        for real in SolidCase::reals(gpu) {
            // Other tests use the same device: buffers are compared one by one instead of all that was allocated.
            let b = case.upload(gpu, real);
            let bytes = |label: &str| {
                let all = [b.plan.buffers(), b.plan.small_buffers()].concat();
                let found: Vec<u64> = all
                    .iter()
                    .filter(|plan| plan.label == label)
                    .map(BufferPlan::bytes)
                    .collect();
                assert_eq!(found.len(), 1, "{label}");
                found[0]
            };
            let mut made = vec![
                (b.step.label(), b.step.bytes()),
                (b.rest.label(), b.rest.bytes()),
                (b.displacement.label(), b.displacement.bytes()),
                (b.velocity.words.label(), b.velocity.words.bytes()),
                (b.flags.label(), b.flags.bytes()),
                (b.gaps.label(), b.gaps.bytes()),
                (b.freedom.label(), b.freedom.bytes()),
                (b.answer.label(), b.answer.bytes()),
                (b.elements.label(), b.elements.bytes()),
                (
                    b.rest_gradients.words.label(),
                    b.rest_gradients.words.bytes(),
                ),
                (b.damping.label(), b.damping.bytes()),
                (b.rotated.words.label(), b.rotated.words.bytes()),
                (
                    b.element_forces.words.label(),
                    b.element_forces.words.bytes(),
                ),
                (b.load.words.label(), b.load.words.bytes()),
                (b.prescribed.label(), b.prescribed.bytes()),
                (b.partials.words.label(), b.partials.words.bytes()),
                (b.extremes.label(), b.extremes.bytes()),
                (b.report.label(), b.report.bytes()),
            ];
            let turning = b.turning.as_ref();
            made.extend(turning.map(|turning| (turning.label(), turning.bytes())));
            assert_eq!(made.len(), b.plan.buffers().len() + 1);
            for (label, found) in made {
                assert_eq!(bytes(label), found, "{}: {label}", case.name);
            }
            assert_eq!(b.level.is_some(), b.plan.obstacles);
            assert_eq!(b.turning.is_some(), b.plan.n_turning > 0);
        }
    }
}
