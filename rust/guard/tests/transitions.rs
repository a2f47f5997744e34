//! The transitions of the guard beside those of its twin in Python (tests/control/safety/test_twin.py writes the file).

use needleplan_guard::advance::{ordered, validated};
use needleplan_guard::cause::{Causes, Owner};
use needleplan_guard::state::{Motion, Operating, Order, Report, State};

fn owner(number: i64) -> Option<Owner> {
    usize::try_from(number).ok().map(|number| Owner::ALL[number])
}

fn state(numbers: &[i64]) -> State {
    State {
        operating: Operating::ALL[numbers[0] as usize],
        is_homed: numbers[1] == 1,
        is_busy: numbers[2] == 1,
        present: Causes(numbers[3] as u64),
        latched: Causes(numbers[4] as u64),
        since_ns: numbers[5],
        held_by: owner(numbers[6]),
        motion: owner(numbers[7]),
        is_zero_lost: numbers[8] == 1,
        first: Causes(numbers[9] as u64),
        is_stopping: numbers[10] == 1,
        waits: owner(numbers[11]),
    }
}

#[test]
fn they_are_those_of_the_twin() {
    let mut count = 0;
    for line in include_str!("transitions.csv").lines() {
        let numbers: Vec<i64> = line.split(',').map(|number| number.parse().unwrap()).collect();
        let (before, event, now_ns, after) = (state(&numbers), &numbers[12..17], numbers[17], &numbers[18..]);
        let step = if event[0] >= 0 {
            ordered(before, Order::ALL[event[0] as usize], owner(event[1]).unwrap(), now_ns)
        } else {
            let (is_busy, is_retracting, is_resting) = (event[2] == 1, event[3] == 1, event[4] == 1);
            validated(before, Report { causes: Causes(event[1] as u64), is_busy, is_retracting, is_resting }, now_ns)
        };
        let motion = match after[2] {
            0 => Some(Motion::Move),
            1 => Some(Motion::Retract),
            _ => None,
        };
        assert_eq!((step.is_refused, step.stops, step.motion), (after[0] == 1, after[1] == 1, motion), "{line}");
        assert_eq!((step.causes, step.state), (Causes(after[3] as u64), state(&after[4..])), "{line}");
        count += 1;
    }
    assert_eq!(count, 2000);
}
