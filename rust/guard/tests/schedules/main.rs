//! All schedules of a guard, its supervisor and a robot behind a network that loses, doubles or delays one datagram.
//!
//! The needle moves inward. Two things happen, at any two moments within 15 and 50 ms: orders of two people and the loop,
//! causes, a stop that is sent before its order, a program that hangs. Meanwhile the program repeats its STOP, and each
//! command until the robot has accepted it. One datagram, of each that is sent, is lost, or comes again or only later.
//! Then 10,000 longer histories at random, with up to eight events and four such datagrams.
//! Guard, supervisor and session are those of the crate; program, network and robot stand here.
#![cfg(feature = "robot")]

mod axis;
mod events;
mod random;
#[path = "../robot/mod.rs"]
mod robot;
mod world;

use events::{EVENTS, Fate, Fault, Mutant, Schedule};
use random::Draw;
use world::{LATEST, SLOTS, World};

/// Random histories, and their slots: 1 s.
const HISTORIES: u64 = 10_000;
const LONG: i64 = 200;

fn run(schedule: &Schedule, slots: i64, mutant: Option<Mutant>) -> Option<&'static str> {
    let mut world = World::new(schedule, mutant);
    (0..slots).find_map(|_| world.slot(&schedule.events))
}

/// All schedules whose first event is in slot `begin`.
fn schedules(begin: i64, counted: u32) -> Vec<Schedule> {
    let fates = [Fate::Lost, Fate::Again(6), Fate::Late(1), Fate::Late(LATEST)];
    let of_way = |way| (0..6).flat_map(move |at| fates.map(|fate| vec![(way, at, fate)]));
    let faults: Vec<Vec<Fault>> = std::iter::once(vec![]).chain(of_way(true)).chain(of_way(false)).collect();
    let mut all = Vec::new();
    for one in EVENTS {
        for after in 0..8 {
            for two in EVENTS {
                let events = vec![(begin, one), (begin + after, two)];
                let of = |faults: &Vec<Fault>| Schedule { events: events.clone(), faults: faults.clone(), counted };
                all.extend(faults.iter().map(of));
            }
        }
    }
    all
}

#[test]
fn no_schedule_lets_the_needle_move_when_it_must_stand_or_loses_an_order() {
    let of = |(begin, counted)| {
        let all = schedules(begin, counted);
        let wrong: Vec<_> =
            all.iter().filter_map(|each| run(each, SLOTS, None).map(|mistake| (mistake, each.clone()))).collect();
        (all.len(), wrong)
    };
    let found = std::thread::scope(|scope| {
        // The second half counts beyond the largest number: all counters wrap in the first slots.
        let begins = [(1, 0), (2, u32::MAX - 4)].map(|begin| scope.spawn(move || of(begin)));
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
    let all = schedules(2, 0);
    for mutant in [OldNumbers, NoRepetition, RestsAtOnce, NeverLate, NoWatchdog, PassesAll] {
        assert!(all.iter().any(|each| run(each, SLOTS, Some(mutant)).is_some()), "{mutant:?} is not found");
    }
}

/// A random history of 1 s: up to eight events, and up to four datagrams that are lost or come again or late.
fn history(seed: u64) -> Schedule {
    let mut draw = Draw::new(seed);
    let mut at = 1 + draw.below(4) as i64;
    let mut events = Vec::new();
    for _ in 0..=draw.below(8) {
        events.push((at, EVENTS[draw.below(EVENTS.len() as u64) as usize]));
        at += [0, 1, 2, 4, 8, 16, 32][draw.below(7) as usize];
    }
    // Faults are so far apart that the repetition of a datagram is not lost, too: BOUND is for one of them.
    let mut number = draw.below(8) as usize;
    let fates = [Fate::Lost, Fate::Again(6), Fate::Late(1), Fate::Late(LATEST)];
    let faults = (0..draw.below(5)).map(|_| {
        let fault = (draw.below(2) == 0, number, fates[draw.below(4) as usize]);
        number += 40 + draw.below(40) as usize;
        fault
    });
    let faults = faults.collect();
    let counted = if draw.below(4) == 0 { u32::MAX - draw.below(60) as u32 } else { draw.below(1 << 32) as u32 };
    Schedule { events, faults, counted }
}

#[test]
fn no_random_history_lets_the_needle_move_when_it_must_stand_or_loses_an_order() {
    let wrong: Vec<_> = std::thread::scope(|scope| {
        let halves = [0, 1].map(|half| {
            scope.spawn(move || {
                let seeds = (half..HISTORIES).step_by(2);
                seeds.filter_map(|seed| run(&history(seed), LONG, None).map(|found| (seed, found))).collect::<Vec<_>>()
            })
        });
        halves.into_iter().flat_map(|half| half.join().unwrap()).collect()
    });
    let first = wrong.first().map(|(seed, _)| history(*seed));
    assert!(wrong.is_empty(), "{} of {HISTORIES}: {:?} {first:#?}", wrong.len(), &wrong[..wrong.len().min(6)]);
}

#[test]
fn the_random_histories_find_mistakes() {
    use Mutant::{NeverLate, NoRepetition, NoWatchdog, OldNumbers, PassesAll, RestsAtOnce};
    for mutant in [OldNumbers, NoRepetition, RestsAtOnce, NeverLate, NoWatchdog, PassesAll] {
        assert!(
            (0..HISTORIES).any(|seed| run(&history(seed), LONG, Some(mutant)).is_some()),
            "{mutant:?} is not found"
        );
    }
}
