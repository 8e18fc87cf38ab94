//! The buffers of the solids hold what they were given.

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
            assert!((found - wanted).abs() <= wanted.abs() * eps(real), "{found} for {wanted}");
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
