//! All schedules of a guard, its supervisor and a robot behind a network that loses, doubles or delays one datagram.
//!
//! The needle moves inward. Two things happen, at any two moments within 15 and 50 ms: orders of two people and the loop,
//! causes, a stop that is sent before its order, a program that hangs. Meanwhile the program repeats its STOP, and each
//! command until the robot has accepted it. One datagram, of each that is sent, is lost, or comes again or only later.
//! Guard, supervisor and session are those of the crate; program, network and robot stand here.
#![cfg(feature = "robot")]

mod axis;
mod events;
#[path = "../robot/mod.rs"]
mod robot;
mod world;

use events::{EVENTS, Fate, Fault, Mutant, Schedule};
use world::{LATEST, SLOTS, World};

fn run(schedule: &Schedule, mutant: Option<Mutant>) -> Option<&'static str> {
    let mut world = World::new(schedule, mutant);
    (0..SLOTS).find_map(|_| world.slot(&schedule.events))
}

/// All schedules whose first event is in slot `begin`.
fn schedules(begin: i64) -> Vec<Schedule> {
    let fates = [Fate::Lost, Fate::Again(6), Fate::Late(1), Fate::Late(LATEST)];
    let of_way = |way| (0..6).flat_map(move |at| fates.map(|fate| Some((way, at, fate))));
    let faults: Vec<Fault> = std::iter::once(None).chain(of_way(true)).chain(of_way(false)).collect();
    let mut all = Vec::new();
    for one in EVENTS {
        for after in 0..8 {
            for two in EVENTS {
                let events = [(begin, one), (begin + after, two)];
                all.extend(faults.iter().map(|fault| Schedule { events, fault: *fault }));
            }
        }
    }
    all
}

#[test]
fn no_schedule_lets_the_needle_move_when_it_must_stand_or_loses_an_order() {
    let of = |begin| {
        let all = schedules(begin);
        let wrong: Vec<_> = all.iter().filter_map(|each| run(each, None).map(|mistake| (mistake, *each))).collect();
        (all.len(), wrong)
    };
    let found = std::thread::scope(|scope| {
        let begins = [1, 2].map(|begin| scope.spawn(move || of(begin)));
        begins.map(|each| each.join().unwrap())
    });
    for (runs, wrong) in &found {
        assert!(wrong.is_empty(), "{} of {runs}: {:#?}", wrong.len(), &wrong[..wrong.len().min(6)]);
        assert_eq!(*runs, 56_448);
    }
}

#[test]
fn the_schedules_find_mistakes() {
    use Mutant::{NeverLate, NoRepetition, NoWatchdog, OldNumbers, PassesAll, RestsAtOnce};
    let all = schedules(2);
    for mutant in [OldNumbers, NoRepetition, RestsAtOnce, NeverLate, NoWatchdog, PassesAll] {
        assert!(all.iter().any(|each| run(each, Some(mutant)).is_some()), "{mutant:?} is not found");
    }
}
