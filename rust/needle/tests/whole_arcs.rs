//! Events of whole arcs against points of them: one arc at a time, and all arcs of a lattice.

use needle::{Arc, Area, Bicycle, Clearance, Event, Setup, SteeringProblem, Tissues, Workspace};
use ppvi::lattice::{Costs, Motion, Shape, Transition, outcome};
use proptest::prelude::*;

/// Points of an arc that the slow twin tests.
const POINTS: usize = 10_000;

/// Distance, mm, by which an arc may touch or miss what it only grazes.
const GRAZE_MM: f64 = 1e-6;

/// A polygon with a hole, a triangle, a disc, a capsule, with or without a margin, around a centre.
fn areas() -> impl Strategy<Value = Area> {
    let places = ((0.0..14.0f64, 0.0..10.0f64), 0.4..2.5f64, 0.0..std::f64::consts::TAU, 0usize..5);
    (places, prop_oneof![Just(0.0), 0.05..1.0f64]).prop_map(|(((x, y), size, turn, kind), margin)| {
        let at = |radius: f64, angle: f64| [x + radius * (angle + turn).cos(), y + radius * (angle + turn).sin()];
        let ring = |radius: f64, angles: &[f64]| angles.iter().map(|angle| at(radius, *angle)).collect::<Vec<_>>();
        let area = match kind {
            0 => Area::polygon(ring(size, &[0.0, 2.0, 4.1])),
            1 => Area::rings(vec![ring(size, &[0.0, 1.5, 3.0, 4.6]), ring(0.4 * size, &[0.0, 1.5, 3.0, 4.6])]),
            2 => Area::disc([x, y], size),
            3 => Area::capsule([x, y], at(size, 0.0), 0.3 * size),
            // With edges along the axes and corners that may lie on the grid.
            _ => {
                let (x, y, size) = (x.round(), y.round(), size.ceil());
                Area::polygon(vec![[x, y], [x + size, y], [x + size, y + 1.0], [x, y + 1.0]])
            }
        };
        area.unwrap().with_margin(margin).unwrap()
    })
}

fn workspaces() -> impl Strategy<Value = Workspace> {
    let target = ((1.0..13.0f64, 1.0..9.0f64), 0.3..1.5f64);
    (prop::collection::vec(areas(), 0..4), target, any::<bool>()).prop_map(|(areas, ((x, y), radius), odd)| {
        let size = if odd { [14.3, 10.6] } else { [14.0, 10.0] };
        Workspace::new(size, areas, [x, y], radius).unwrap()
    })
}

/// Straight, nearly straight, bent, and more than half a circle; headings along the axes are frequent.
fn shapes() -> impl Strategy<Value = (f64, f64, f64)> {
    let heading = prop_oneof![
        0.0..std::f64::consts::TAU,
        (0u8..4).prop_map(|quarter| f64::from(quarter) * std::f64::consts::FRAC_PI_2)
    ];
    let curvature = prop_oneof![Just(0.0), -1e-7..1e-7f64, -0.3..0.3f64, -1.5..1.5f64];
    (heading, curvature, 0.1..6.0f64)
}

/// Whether the point has the event to within the graze.
fn almost(workspace: &Workspace, event: Event, point: [f64; 2]) -> bool {
    let [x, y] = point;
    let [width, height] = workspace.size;
    match event {
        Event::Exit => x < GRAZE_MM || y < GRAZE_MM || x > width - GRAZE_MM || y > height - GRAZE_MM,
        Event::Collision => {
            workspace.obstacles.iter().any(|area| area.clone().with_margin(GRAZE_MM).unwrap().contains(point))
        }
        Event::Target => (x - workspace.target[0]).hypot(y - workspace.target[1]) < workspace.target_radius + GRAZE_MM,
    }
}

/// Whether all arcs that start close by have the same first event.
fn is_clear(workspace: &Workspace, [x, y]: [f64; 2], (heading, curvature, length): (f64, f64, f64)) -> bool {
    let event = |x: f64, y: f64, longer: f64| {
        workspace.first_event(&Arc::new([x, y], heading, curvature, length + longer)).map(|(event, _)| event)
    };
    let here = event(x, y, 0.0);
    let sides = [-GRAZE_MM, 0.0, GRAZE_MM];
    sides.iter().all(|dx| sides.iter().all(|dy| sides.iter().all(|dl| event(x + dx, y + dy, *dl) == here)))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn the_first_event_of_an_arc_is_that_of_its_points(
        workspace in workspaces(), start in (0.0..14.0f64, 0.0..10.0f64), shape in shapes()
    ) {
        let start = [start.0, start.1];
        prop_assume!(workspace.event(start).is_none());
        let (heading, curvature, length) = shape;
        let arc = Arc::new(start, heading, curvature, length);
        let step = length / POINTS as f64;
        let points = (1..=POINTS).map(|n| n as f64 * step);
        let sampled = points.map(|s| (s, workspace.event(arc.point(s)))).find(|(_, event)| event.is_some());
        match workspace.first_event(&arc) {
            Some((event, s)) => {
                prop_assert!((0.0..=length).contains(&s), "{}", s);
                prop_assert!(almost(&workspace, event, arc.point(s)), "{:?} at {} is none", event, s);
                if let Some((first, _)) = sampled {
                    prop_assert!(s <= first + 1e-6, "{:?} at {} after a point at {}", event, s, first);
                }
            }
            None => prop_assert!(sampled.is_none(), "missed {:?}", sampled),
        }
    }

    #[test]
    fn the_outcomes_of_a_lattice_are_the_first_events_of_its_arcs(
        workspace in workspaces(), headings in 4usize..40, radius in 3.0..60.0f64, dx in 0.5..1.6f64, layer in any::<bool>()
    ) {
        let needle = Bicycle::new(radius, headings).unwrap();
        let layers = if layer { vec![(6.0, 0.6 * radius)] } else { Vec::new() };
        let setup = Setup {
            workspace,
            needle,
            spacing: [dx, 1.0],
            noise: vec![1.0],
            noise_step: None,
            arc_samples: 0,
            transition: Transition::Interpolated,
            costs: Costs { step: needle.step_length(), rotation: 4.0, collision: 1e3, exit: 1e3, discount: 1.0 },
            tissues: Tissues::new(layers, Vec::new()).unwrap(),
            clearance: Clearance::default(),
 straight: None,
        };
        let problem = SteeringProblem::new(setup).unwrap();
        let (setup, lattice) = (problem.setup(), problem.lattice());
        let Shape { nx, ny, headings } = lattice.shape();
        let size = setup.workspace.size;
        for (i, j) in (0..nx).flat_map(|i| (0..ny).map(move |j| (i, j))) {
            let start = [i as f64 * dx, j as f64];
            // The border passes through a start that lies beyond it.
            let size = [size[0].max(start[0]), size[1].max(start[1])];
            let workspace = Workspace { size, ..setup.workspace.clone() };
            let needle = setup.tissues.needle_at(needle, start);
            for (k, bevel) in (0..headings).flat_map(|k| [(k, 0), (k, 1)]) {
                let code = lattice.outcome(Motion::Curved, i, j, k, bevel);
                let curvature = (2.0 * bevel as f64 - 1.0) / needle.radius;
                let shape = (needle.heading(k), curvature, needle.step_length());
                let expected = match workspace.event(start) {
                    Some(Event::Target) => outcome::AT_TARGET,
                    Some(_) => outcome::AT_OBSTACLE,
                    None => workspace
                        .first_event(&Arc::new(start, shape.0, shape.1, shape.2))
                        .map_or(outcome::CONTINUES, |(event, _)| event as u8),
                };
                prop_assert!(
                    code == expected || !is_clear(&workspace, start, shape),
                    "{:?} {:?}: {} and not {}", start, shape, code, expected
                );
            }
        }
    }
}

#[test]
fn touching_is_an_event() {
    let square = Area::polygon(vec![[4.0, 2.0], [6.0, 2.0], [6.0, 4.0], [4.0, 4.0]]).unwrap();
    let workspace = Workspace::new([10.0, 6.0], vec![square], [8.0, 1.0], 0.5).unwrap();
    let event = |x: f64, y: f64, heading: f64, curvature: f64, length: f64| {
        workspace.first_event(&Arc::new([x, y], heading, curvature, length))
    };
    // Straight along an edge, onto a corner, to an edge with the end, along the border.
    let (met, s) = event(3.0, 2.0, 0.0, 0.0, 1.5).unwrap();
    assert!(met == Event::Collision && (s - 1.0).abs() < 1e-8);
    assert_eq!(event(3.0, 1.0, std::f64::consts::FRAC_PI_4, 0.0, 2.0).unwrap().0, Event::Collision);
    assert_eq!(event(5.0, 1.0, std::f64::consts::FRAC_PI_2, 0.0, 1.0).unwrap().0, Event::Collision);
    assert_eq!(event(0.0, 0.0, 0.0, 0.0, 7.0), None);
    // An arc whose highest point is on the edge, and one a little lower.
    let top = |y: f64| event(4.0, y, std::f64::consts::FRAC_PI_4, -0.5, 3.0);
    let rise = 2.0 * (1.0 - std::f64::consts::FRAC_PI_4.cos());
    assert_eq!(top(2.0 - rise).unwrap().0, Event::Collision);
    assert_eq!(top(2.0 - rise - 1e-6), None);
    // The target between two points of a long step.
    let (met, s) = event(6.5, 1.0, 0.0, 0.0, 3.4).unwrap();
    assert!(met == Event::Target && (s - 1.0).abs() < 1e-8);
}
