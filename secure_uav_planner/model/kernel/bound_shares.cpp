// Lemma 8's boxes: how the shares and the powers of several jammers are divided. See bound/proof,
// jammer_shares.py, for what they are, and bound/search, division.py, for the arrays.
//
// What is found here may be bad, never wrong: the certificate computes every bound anew.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <numeric>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

#include "array.hpp"
#include "bound_detours.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::expect;
using kernel::size_of;

namespace {

constexpr std::size_t kJammers = 3;         // At most.
constexpr std::size_t kReceivers = 9;       // The ground node and all eavesdroppers, at most.
constexpr std::size_t kListeners = 4;       // Eavesdroppers in boxes, at most.
constexpr std::size_t kCorners = 27;        // Of a box of shares, at most.
constexpr int kRounds = 16;                 // Of a search for a better place and power.
constexpr double kFinest = 0.02;            // Share of its first steps with which it ends.
constexpr int kSweeps = 3;                  // Of one jammer after the other.
constexpr double kFaint = 20.0;             // Of log p below the peak, where jammers are sought.
constexpr int kMixing = 25;                 // Of a search for the corners that make up the bound.
constexpr double kApart = 0.3;              // By how much two starts differ for somebody, in nats.
constexpr double kActive = 0.03;            // Part of a corner from which it counts.
constexpr double kExact = 5e-4;             // In nats.
constexpr int kHalvings = 14;               // Of the interval in which the best theta are.
constexpr int kOften = 4;                   // Cuts after which new theta are looked for.
constexpr double kWorth = 0.02;             // By how much they lower the bound at least, in nats.
constexpr double kHuge = std::numeric_limits<double>::infinity();

// A jammer's place, log p and p, its worth without the rates, and J x at the receivers.
struct Column {
    double place[2], power, watts, base, received[kReceivers];
};

// What all jammers of a mission can do.
class Jammers {
public:
    explicit Jammers(const py::dict& given)
        : stages_(given["stages"].cast<std::size_t>()), jammers_(size_of(given, "altitude")),
          receivers_(size_of(given, "radii") / jammers_),
          columns_(size_of(given, "power") / (jammers_ * stages_)),
          place_(given, "place", 2 * jammers_ * stages_ * columns_),
          power_(given, "power", jammers_ * stages_ * columns_),
          base_(given, "base", jammers_ * stages_ * columns_),
          pull_(given, "pull", 2 * jammers_ * stages_),
          people_(given, "people", 2 * jammers_ * receivers_),
          radii_(given, "radii", jammers_ * receivers_),
          gain_(given, "gain", jammers_ * receivers_),
          altitude_(given, "altitude", jammers_), distance_(given, "distance", jammers_),
          price_(given, "price", jammers_), peak_(given, "peak", jammers_),
          from_start_(given, "from_start", jammers_ * stages_),
          to_goal_(given, "to_goal", jammers_ * stages_),
          width_(given, "width", jammers_ * stages_), detours_(given) {
        expect(jammers_ <= kJammers && receivers_ > 1 && receivers_ <= kReceivers, "radii");
    }

    std::size_t jammers() const { return jammers_; }
    std::size_t eavesdroppers() const { return receivers_ - 1; }
    std::size_t stages() const { return stages_; }
    double price(std::size_t j) const { return price_[j]; }
    double peak(std::size_t j) const { return peak_[j]; }

    // The columns of a jammer in a stage.
    std::vector<Column> of(std::size_t j, std::size_t stage) const {
        std::vector<Column> found(columns_);
        for (std::size_t c = 0; c < columns_; ++c) {
            const std::size_t at = (j * stages_ + stage) * columns_ + c;
            found[c] = {{place_[2 * at], place_[2 * at + 1]}, power_[at], std::exp(power_[at]),
                        base_[at], {}};
            receive(j, found[c]);
        }
        return found;
    }

    void receive(std::size_t j, Column& column) const {
        const double square = altitude_[j] * altitude_[j];
        for (std::size_t r = 0; r < receivers_; ++r) {
            const std::size_t at = j * receivers_ + r;
            const double x = column.place[0] - people_[2 * at];
            const double y = column.place[1] - people_[2 * at + 1];
            const double d = std::sqrt(x * x + y * y) + radii_[at];
            column.received[r] = gain_[at] * column.watts / (d * d + square);
        }
    }

    // Move a column to where it is worth more, with log p between two ends.
    template <typename Worth>
    void improve(std::size_t j, std::size_t stage, double least, double most, double share,
                 const Worth& worth, Column& column) const {
        double step = share * width_[j * stages_ + stage] / 12, ratio = share * 0.4;
        const double least_step = kFinest * step, least_ratio = kFinest * ratio;
        double top = worth(column);
        const double* pull = &pull_[2 * (j * stages_ + stage)];
        for (int round = 0; round < kRounds; ++round) {
            Column next = column;
            for (int move = 0; move < 6; ++move) {
                Column trial = column;
                const double sign = move % 2 ? -1 : 1;
                if (move < 4) {
                    const int axis = move / 2;
                    trial.place[axis] += sign * step;
                    if (!draw_in(j, stage, trial.place)) continue;
                    for (int i = 0; i < 2; ++i)
                        trial.base += pull[i] * (trial.place[i] - column.place[i]);
                } else {
                    trial.power = std::min(std::max(trial.power + sign * ratio, least), most);
                    if (!(trial.power != column.power)) continue;
                    trial.watts = std::exp(trial.power);
                }
                receive(j, trial);
                const double value = worth(trial);
                if (value > top) {
                    top = value;
                    next = trial;
                }
            }
            if (next.power == column.power) ratio /= 2.5;
            if (next.place[0] == column.place[0] && next.place[1] == column.place[1]) step /= 2.5;
            column = next;
            if (step < least_step && ratio < least_ratio) break;
        }
    }

    // Move all jammers' columns with the same number to where they are worth more together.
    void improve_together(std::size_t stage, double weight, const double* v) {
        std::vector<Column> own[kJammers];
        for (std::size_t j = 0; j < jammers_; ++j) own[j] = of(j, stage);
        for (std::size_t number = 0; number < columns_; ++number)
            for (int sweep = 0; sweep < kSweeps; ++sweep)
                for (std::size_t j = 0; j < jammers_; ++j) {
                    double noise[kReceivers];
                    for (std::size_t r = 0; r < receivers_; ++r) {
                        noise[r] = 1.0;
                        for (std::size_t i = 0; i < jammers_; ++i)
                            if (i != j) noise[r] += own[i][number].received[r] / double(jammers_);
                    }
                    const auto worth = [&](const Column& one) {
                        double value = one.base - price_[j] * one.watts;
                        for (std::size_t r = 0; r < receivers_; ++r)
                            value += (r ? v[r - 1] : -weight)
                                * std::log(noise[r] + one.received[r] / double(jammers_));
                        return value;
                    };
                    Column& one = own[j][number];
                    improve(j, stage, peak_[j] - kFaint, peak_[j], std::pow(0.3, sweep), worth,
                            one);
                    const std::size_t at = (j * stages_ + stage) * columns_ + number;
                    std::copy(one.place, one.place + 2, &place_[2 * at]);
                    power_[at] = one.power;
                }
    }

private:
    // Draw a place into one disc and then into the other; return whether it is in both and reached
    // in time.
    bool draw_in(std::size_t j, std::size_t stage, double* place) const {
        const double radius[2] = {from_start_[j * stages_ + stage], to_goal_[j * stages_ + stage]};
        const auto excess = [&](int disc) {
            const double along = place[0] - disc * distance_[j];
            return (along * along + place[1] * place[1]) / (radius[disc] * radius[disc]);
        };
        for (int disc = 0; disc < 2; ++disc) {
            const double much = excess(disc);
            if (much <= 1.0) continue;
            const double part = (1 - 1e-9) / std::sqrt(much), middle = disc * distance_[j];
            place[0] = middle + part * (place[0] - middle);
            place[1] *= part;
        }
        return excess(0) <= 1.0 && detours_.reaches(j, place, place, radius[0], radius[1]);
    }

    std::size_t stages_, jammers_, receivers_, columns_;
    Array<double> place_, power_;
    Array<const double> base_, pull_, people_, radii_, gain_, altitude_, distance_, price_, peak_,
        from_start_, to_goal_, width_;
    kernel::Detours detours_;
};

// Columns of one jammer with log p in an interval, with what each costs, and log(1 + J x) at the
// ground node and elsewhere.
struct List {
    double low, high;
    std::vector<Column> all;
    std::vector<double> own, ground, heard[kListeners];
};

// A piece of the maximum over columns as a function of theta: the column that is best up to `end`.
struct Piece {
    std::size_t column;
    double end;
};

struct Cut {
    std::size_t first, second;  // Corners of a simplex of shares; else both are 0.
    double at;
};

struct Box {
    double share[kListeners][kJammers][kJammers];  // At the corners of every simplex.
    double theta[kListeners][kJammers][kJammers];  // What every simplex's corners add to theta.
    std::shared_ptr<List> list[kJammers];
    double mean[kListeners][kJammers];             // The shares at which the bound is attained.
    double known[kJammers][kCorners];
    std::uint32_t best[kJammers][kCorners];        // The columns that are worth that.
    double part[kCorners];                         // Of the corners in what attains the bound.
    double bound;
    int cuts;                                      // So far.
    Cut cut[kListeners + kJammers];
    bool useful[kListeners + kJammers];
};

// The division at one breakpoint, by those of the listeners whose v is above 0.
class Division {
public:
    Division(const Jammers& jammers, std::size_t stage, double weight, std::size_t slots,
             const double* v, const std::int64_t* listening)
        : all_(jammers), stage_(stage), jammers_(jammers.jammers()), slots_(slots),
          weight_(weight) {
        for (std::size_t slot = 0; slot < slots; ++slot) {
            if (!(v[slot] > 0) && (listeners_ > 0 || slot + 1 < slots)) continue;
            slot_[listeners_] = slot;
            v_[listeners_] = v[slot];
            who_[listeners_++] = listening[slot];
        }
        corners_ = power(listeners_);
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            std::size_t rest = corner;
            for (std::size_t e = listeners_; e-- > 0; rest /= jammers_)
                which_[corner][e] = rest % jammers_;
        }
    }

    Box whole() const {
        Box box{};
        for (std::size_t e = 0; e < listeners_; ++e)
            for (std::size_t j = 0; j < jammers_; ++j) box.share[e][j][j] = 1.0;
        const double each = 1.0 / double(jammers_ * listeners_);
        std::fill(&box.theta[0][0][0], &box.theta[0][0][0] + sizeof box.theta / sizeof each, each);
        for (std::size_t j = 0; j < jammers_; ++j) {
            box.list[j] = std::make_shared<List>(List{-kHuge, kHuge, {}, {}, {}, {}});
            std::set<std::tuple<double, double, double>> seen;
            for (const Column& one : all_.of(j, stage_))
                if (seen.insert({one.power, one.place[0], one.place[1]}).second)
                    add(j, *box.list[j], one);
        }
        std::fill(box.part, box.part + corners_, 1.0 / double(corners_));
        fit(box);
        turn(box, -kHuge);
        extend(box, true);
        turn(box, kWorth);
        return box;
    }

    // Cut a box as lowers it most, keep one part, return the other: false where nothing helps.
    bool split(Box& box, Box& rest, std::int64_t* side, double* at) const {
        Box best;
        double score = kHuge;
        for (std::size_t s = 0; s < listeners_ + jammers_; ++s) {
            if (!box.useful[s]) continue;
            const Cut& cut = box.cut[s];
            Box part[2] = {box, box};
            if (s < listeners_) {
                for (std::size_t j = 0; j < jammers_; ++j) {
                    const double first = box.share[s][cut.first][j];
                    const double moved = std::max(
                        first + cut.at * (box.share[s][cut.second][j] - first), 0.0);
                    part[0].share[s][cut.second][j] = part[1].share[s][cut.first][j] = moved;
                    const double theta = box.theta[s][cut.first][j];
                    part[0].theta[s][cut.second][j] = part[1].theta[s][cut.first][j] =
                        theta + cut.at * (box.theta[s][cut.second][j] - theta);
                }
                fit(part[0], s, cut.second);
                fit(part[1], s, cut.first);
            } else {
                const std::size_t j = s - listeners_;
                draw(part[0], j, box.list[j]->low, cut.at);
                draw(part[1], j, cut.at, box.list[j]->high);
            }
            const double more = std::max(part[0].bound, part[1].bound)
                                + 1e-3 * std::min(part[0].bound, part[1].bound);
            if (!(more < score)) continue;
            score = more;
            best = std::move(part[0]);
            rest = std::move(part[1]);
            const std::size_t edges = jammers_ * jammers_;
            *side = std::int64_t(
                s < listeners_ ? slot_[s] * edges + cut.first * jammers_ + cut.second
                               : slots_ * edges + s - listeners_);
            *at = cut.at;
        }
        if (score == kHuge) return false;
        box = std::move(best);
        for (Box* one : {&box, &rest}) {
            extend(*one, false);
            if (++one->cuts % kOften == 0) turn(*one, kWorth);
        }
        return true;
    }

    // Write what the certificate needs of a box: nobody else's corners make a difference.
    void write(const Box& box, double* theta, double* mean, double* known) const {
        std::fill(theta, theta + slots_ * jammers_ * jammers_, 0.0);
        for (std::size_t e = 0; e < listeners_; ++e)
            for (std::size_t i = 0; i < jammers_; ++i) {
                mean[slot_[e] * jammers_ + i] = box.mean[e][i];
                std::copy(box.theta[e][i], box.theta[e][i] + jammers_,
                          theta + (slot_[e] * jammers_ + i) * jammers_);
            }
        for (std::size_t j = 0; j < jammers_; ++j)
            for (std::size_t number = 0; number < power(slots_); ++number) {
                std::size_t corner = 0;
                for (std::size_t e = 0; e < listeners_; ++e)
                    corner = corner * jammers_
                             + number / power(slots_ - 1 - slot_[e]) % jammers_;
                *known++ = box.known[j][corner];
            }
    }

private:
    // The number of corners of so many listeners' simplices.
    std::size_t power(std::size_t listeners) const {
        return listeners ? jammers_ * power(listeners - 1) : 1;
    }

    void add(std::size_t j, List& list, const Column& column) const {
        list.all.push_back(column);
        list.own.emplace_back();
        list.ground.emplace_back();
        for (std::size_t e = 0; e < listeners_; ++e) list.heard[e].emplace_back();
        value(j, list, list.all.size() - 1);
    }

    // Find what a column costs and what is received of it.
    void value(std::size_t j, List& list, std::size_t c) const {
        const Column& column = list.all[c];
        list.own[c] = column.base - all_.price(j) * column.watts;
        list.ground[c] = std::log1p(column.received[0]);
        for (std::size_t e = 0; e < listeners_; ++e)
            list.heard[e][c] = std::log1p(column.received[who_[e] + 1]);
    }

    // Draw a box's columns of a jammer into an interval of log p, and fit the box.
    void draw(Box& box, std::size_t j, double low, double high) const {
        box.list[j] = std::make_shared<List>(*box.list[j]);
        List& list = *box.list[j];
        list.low = low;
        list.high = high;
        for (std::size_t c = 0; c < list.all.size(); ++c) {
            Column& column = list.all[c];
            const double power =
                std::min(std::max(column.power, low), std::min(high, all_.peak(j)));
            if (power == column.power) continue;
            column.power = power;
            column.watts = std::exp(power);
            all_.receive(j, column);
            value(j, list, c);
        }
        for (std::size_t corner = 0; corner < corners_; ++corner) look(box, j, corner);
        bound(box);
        choose(box);
    }

    double theta(const Box& box, std::size_t j, std::size_t corner) const {
        double sum = 0.0;
        for (std::size_t e = 0; e < listeners_; ++e) sum += box.theta[e][which_[corner][e]][j];
        return sum;
    }

    // The number of jammer j's best column at a corner with some theta, and what it is worth.
    std::pair<std::size_t, double> best(const Box& box, std::size_t j, std::size_t corner,
                                        double theta) const {
        const List& list = *box.list[j];
        const std::size_t count = list.own.size();
        many_.resize(count);
        double* value = many_.data();
        for (std::size_t c = 0; c < count; ++c)
            value[c] = list.own[c] - weight_ * theta * list.ground[c];
        for (std::size_t e = 0; e < listeners_; ++e) {
            const double w = v_[e] * box.share[e][which_[corner][e]][j];
            if (w == 0) continue;
            const double* heard = list.heard[e].data();
            for (std::size_t c = 0; c < count; ++c) value[c] += w * heard[c];
        }
        const std::size_t top = std::size_t(std::max_element(value, value + count) - value);
        return {top, value[top]};
    }

    void look(Box& box, std::size_t j, std::size_t corner) const {
        const auto [top, value] = best(box, j, corner, theta(box, j, corner));
        box.best[j][corner] = std::uint32_t(top);
        box.known[j][corner] = value;
    }

    // The theta that minimise F at a corner: log theta - log(1 + J x) is the same for all jammers.
    void best_theta(const Box& box, std::size_t corner, const std::vector<std::size_t>* order,
                    double* theta) const {
        std::vector<Piece> pieces[kJammers];
        double most = 1.0;
        for (std::size_t j = 0; j < jammers_; ++j) {
            const List& list = *box.list[j];
            best(box, j, corner, 0.0);
            // Lines with falling slopes: each is best up to where the next one is better.
            for (const std::size_t c : order[j]) {
                while (!pieces[j].empty()) {
                    const std::size_t last = pieces[j].back().column;
                    // They meet where theta is the first over the second.
                    const double less = many_[last] - many_[c], steeper =
                        std::max(weight_ * (list.ground[last] - list.ground[c]), 1e-300);
                    if (less >= steeper) break;
                    const double begin =
                        pieces[j].size() > 1 ? pieces[j][pieces[j].size() - 2].end : 0.0;
                    if (less > begin * steeper) {
                        pieces[j].back().end = less / steeper;
                        pieces[j].push_back({c, 1.0});
                        break;
                    }
                    pieces[j].pop_back();
                }
                if (pieces[j].empty()) pieces[j].push_back({c, 1.0});
            }
            most = std::max(most, 1.0 + list.all[order[j].front()].received[0]);
        }
        // One theta is at least 1 / J, and one at most that, and the noise at least 1.
        double high = -std::log(double(jammers_)), low = high - std::log(most), sum;
        for (int k = 0; k < kHalvings; ++k) {
            const double level = std::exp((low + high) / 2);
            sum = 0.0;
            for (std::size_t j = 0; j < jammers_; ++j) {
                double begin = 0.0;
                for (const Piece& piece : pieces[j]) {
                    theta[j] = std::max(
                        level * (1.0 + box.list[j]->all[piece.column].received[0]), begin);
                    begin = piece.end;
                    if (theta[j] <= begin) break;
                }
                theta[j] = std::min(theta[j], 1.0);
                sum += theta[j];
            }
            (sum < 1.0 ? low : high) = (low + high) / 2;
        }
        for (std::size_t j = 0; j < jammers_; ++j) theta[j] /= sum;
    }

    // Find better theta, if they lower the bound by as much.
    void turn(Box& box, double least) const {
        // Columns in the order in which the ground hears them.
        std::vector<std::size_t> order[kJammers];
        for (std::size_t j = 0; j < jammers_; ++j) {
            const std::vector<double>& ground = box.list[j]->ground;
            order[j].resize(ground.size());
            std::iota(order[j].begin(), order[j].end(), 0);
            std::sort(order[j].begin(), order[j].end(), [&](std::size_t one, std::size_t two) {
                return ground[one] > ground[two];
            });
        }
        double middle[kJammers] = {}, part[kListeners][kJammers][kJammers] = {};
        const double each = 1.0 / double(corners_);
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            double at[kJammers];
            best_theta(box, corner, order, at);
            for (std::size_t j = 0; j < jammers_; ++j) {
                middle[j] += each * at[j];
                for (std::size_t e = 0; e < listeners_; ++e)
                    part[e][which_[corner][e]][j] += each * double(jammers_) * at[j];
            }
        }
        // As an affine function of the shares, not negative.
        Box trial = box;
        double factor = 1.0;
        for (std::size_t j = 0; j < jammers_; ++j) {
            double least = 0.0;
            for (std::size_t e = 0; e < listeners_; ++e) {
                for (std::size_t i = 0; i < jammers_; ++i) part[e][i][j] -= middle[j];
                double lowest = part[e][0][j];
                for (std::size_t i = 1; i < jammers_; ++i)
                    lowest = std::min(lowest, part[e][i][j]);
                least += lowest;
            }
            if (middle[j] + least < 0)
                factor = std::min(factor, (1 - 1e-9) * middle[j] / -least);
        }
        for (std::size_t e = 0; e < listeners_; ++e)
            for (std::size_t i = 0; i < jammers_; ++i)
                for (std::size_t j = 0; j < jammers_; ++j)
                    trial.theta[e][i][j] =
                        factor * part[e][i][j] + middle[j] / double(listeners_);
        fit(trial);
        if (trial.bound < box.bound - least) box = trial;
    }

    // Find the bound and the cuts of a box; if only one corner of a simplex has changed, by that.
    void fit(Box& box, std::size_t simplex = kListeners, std::size_t changed = 0) const {
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            if (simplex < kListeners && which_[corner][simplex] != changed) continue;
            for (std::size_t j = 0; j < jammers_; ++j) look(box, j, corner);
        }
        bound(box);
        choose(box);
    }

    // The best column at a corner that somebody receives otherwise than the best one: often one is
    // silent and the other loud.
    std::size_t other(const Box& box, std::size_t j, std::size_t corner, std::size_t one) const {
        const List& list = *box.list[j];
        best(box, j, corner, theta(box, j, corner));
        std::size_t found = one;
        for (std::size_t c = 0; c < many_.size(); ++c) {
            double apart = std::abs(list.ground[c] - list.ground[one]);
            for (std::size_t e = 0; e < listeners_; ++e)
                apart = std::max(apart, std::abs(list.heard[e][c] - list.heard[e][one]));
            if (apart > kApart && (found == one || many_[c] > many_[found])) found = c;
        }
        return found;
    }

    // Add what is better than the columns at the corners, sought from two of them or from one.
    void extend(Box& box, bool widely) const {
        bool better = false;
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            if (box.part[corner] < kActive) continue;
            for (std::size_t j = 0; j < jammers_; ++j) {
                double w[kListeners];
                for (std::size_t e = 0; e < listeners_; ++e)
                    w[e] = v_[e] * box.share[e][which_[corner][e]][j];
                const double ground = weight_ * theta(box, j, corner);
                const auto worth = [&](const Column& one) {
                    double value = one.base - all_.price(j) * one.watts
                                   - ground * std::log1p(one.received[0]);
                    for (std::size_t e = 0; e < listeners_; ++e)
                        if (w[e] != 0) value += w[e] * std::log1p(one.received[who_[e] + 1]);
                    return value;
                };
                List& list = *box.list[j];
                const std::size_t top = box.best[j][corner];
                const std::size_t second = widely ? other(box, j, corner, top) : top;
                for (const std::size_t start : std::set{top, second}) {
                    Column column = list.all[start];
                    all_.improve(j, stage_, list.low, std::min(list.high, all_.peak(j)), 1.0,
                                 worth, column);
                    if (!(worth(column) > box.known[j][corner] + 3e-4)) continue;
                    add(j, list, column);
                    better = true;
                }
            }
        }
        if (better) fit(box);
    }

    // Find the mixture of corners that attains the bound; see over_boxes.
    void bound(Box& box) const {
        double total = 1e-12, mean[kListeners][kJammers], cross[kListeners][kJammers];
        for (std::size_t e = 0; e < listeners_; ++e) total += v_[e];
        double values[kCorners];
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            values[corner] = weight_ * std::log(double(jammers_));
            for (std::size_t j = 0; j < jammers_; ++j) {
                const double at = theta(box, j, corner);
                values[corner] += box.known[j][corner];
                if (at > 0) values[corner] += weight_ * at * std::log(at);
            }
            box.part[corner] = 0.9 * box.part[corner] + 0.1 / double(corners_);
        }
        box.bound = kHuge;
        for (int round = 0; round < kMixing; ++round) {
            for (std::size_t e = 0; e < listeners_; ++e) {
                double share[kJammers] = {};
                for (std::size_t corner = 0; corner < corners_; ++corner)
                    share[which_[corner][e]] += box.part[corner];
                double logs[kJammers];
                for (std::size_t j = 0; j < jammers_; ++j) {
                    mean[e][j] = 1e-300;
                    for (std::size_t i = 0; i < jammers_; ++i)
                        mean[e][j] += share[i] * box.share[e][i][j];
                    logs[j] = std::log(mean[e][j]);
                }
                for (std::size_t i = 0; i < jammers_; ++i) {
                    cross[e][i] = -std::log(double(jammers_));
                    for (std::size_t j = 0; j < jammers_; ++j)
                        cross[e][i] -= box.share[e][i][j] * logs[j];
                }
            }
            double worth[kCorners], top = -kHuge, reached = 0.0;
            for (std::size_t corner = 0; corner < corners_; ++corner) {
                worth[corner] = values[corner];
                for (std::size_t e = 0; e < listeners_; ++e)
                    worth[corner] += v_[e] * cross[e][which_[corner][e]];
                top = std::max(top, worth[corner]);
                reached += box.part[corner] * worth[corner];
            }
            if (top < box.bound) {
                box.bound = top;
                std::copy(&mean[0][0], &mean[0][0] + kListeners * kJammers, &box.mean[0][0]);
            }
            if (top - reached < kExact) break;
            double sum = 0.0;
            for (std::size_t corner = 0; corner < corners_; ++corner)
                sum += box.part[corner] *= std::exp(1.5 * (worth[corner] - top) / total);
            for (std::size_t corner = 0; corner < corners_; ++corner) box.part[corner] /= sum;
        }
    }

    // Find where every simplex of shares and every power may be cut.
    void choose(Box& box) const {
        std::fill(box.useful, box.useful + kListeners + kJammers, false);
        for (std::size_t e = 0; e < listeners_; ++e) {
            double share[kJammers] = {}, most = 1e-6;
            for (std::size_t corner = 0; corner < corners_; ++corner)
                share[which_[corner][e]] += box.part[corner];
            for (std::size_t i = 0; i < jammers_; ++i)
                for (std::size_t k = 0; k < i; ++k) {
                    double apart = 0.0;
                    for (std::size_t j = 0; j < jammers_; ++j) {
                        const double gap = box.share[e][i][j] - box.share[e][k][j];
                        apart += gap * gap / box.mean[e][j];
                    }
                    if (!(share[i] * share[k] * apart > most)) continue;
                    most = share[i] * share[k] * apart;
                    box.useful[e] = true;
                    box.cut[e] = {i, k, std::min(std::max(
                        share[k] / (share[i] + share[k]), 0.02), 0.98)};
                }
        }
        for (std::size_t j = 0; j < jammers_; ++j) {
            const Column *quiet = nullptr, *loud = nullptr;
            for (std::size_t corner = 0; corner < corners_; ++corner) {
                if (box.part[corner] < kActive) continue;
                const Column* one = &box.list[j]->all[box.best[j][corner]];
                if (!quiet || one->power < quiet->power) quiet = one;
                if (!loud || one->power > loud->power) loud = one;
            }
            if (!loud || !(quiet->power < loud->power)) continue;
            // The middle of what is heard by whoever hears the louder one best.
            double best = loud->received[0];
            for (std::size_t e = 0; e < listeners_; ++e)
                best = std::max(best, loud->received[who_[e] + 1]);
            const double gain = best / loud->watts;
            const double middle = (std::log1p(best) + std::log1p(gain * quiet->watts)) / 2;
            const double at = std::log(std::expm1(middle) / gain);
            box.useful[listeners_ + j] = at > box.list[j]->low && at < box.list[j]->high;
            box.cut[listeners_ + j] = {0, 0, at};
        }
    }

    const Jammers& all_;
    std::size_t stage_, jammers_, slots_, listeners_ = 0, corners_;
    double weight_, v_[kListeners];
    std::size_t slot_[kListeners];
    std::int64_t who_[kListeners];
    std::size_t which_[kCorners][kListeners];
    mutable std::vector<double> many_;
};

// Divide what jammers can do at M breakpoints.
void share_boxes(const py::dict& given) {
    const Jammers jammers(given);
    const std::size_t count = size_of(given, "stage"), j = jammers.jammers();
    const std::size_t each = std::max<std::size_t>(count, 1);
    const std::size_t e = size_of(given, "listeners") / each, splits = size_of(given, "at") / each;
    expect(e >= 1 && e <= kListeners, "listeners");
    std::size_t corners = 1;
    for (std::size_t l = 0; l < e; ++l) corners *= j;
    expect(corners <= kCorners, "listeners");
    const std::size_t boxes = splits + 1;
    const Array<const std::int64_t> stage(given, "stage", count),
        who(given, "listeners", count * e);
    const Array<const double> weight(given, "weight", count), shares(given, "shares", count * e),
        enough(given, "enough", count);
    const Array<std::int64_t> which(given, "box", count * splits),
        side(given, "side", count * splits);
    const Array<const std::int64_t> most(given, "cuts", count);
    const Array<double> at(given, "at", count * splits),
        means(given, "mean", count * boxes * e * j),
        theta(given, "theta", count * boxes * e * j * j),
        known(given, "known", count * boxes * j * corners);
    for (std::size_t m = 0; m < count; ++m)
        expect(stage[m] >= 0 && std::size_t(stage[m]) < jammers.stages(), "stage");
    for (std::size_t m = 0; m < count * e; ++m)
        expect(who[m] >= 0 && std::size_t(who[m]) < jammers.eavesdroppers(), "listeners");
    const py::gil_scoped_release release;
    for (std::size_t m = 0; m < count; ++m) {
        const Division division(jammers, std::size_t(stage[m]), weight[m], e, &shares[m * e],
                                &who[m * e]);
        std::vector<Box> found{division.whole()};
        for (std::size_t s = 0; s < std::min(splits, std::size_t(most[m])); ++s) {
            std::size_t worst = 0;
            for (std::size_t b = 1; b < found.size(); ++b)
                if (found[b].bound > found[worst].bound) worst = b;
            Box rest;
            if (!(found[worst].bound > enough[m])
                || !division.split(found[worst], rest, &side[m * splits + s],
                                   &at[m * splits + s]))
                break;
            which[m * splits + s] = std::int64_t(worst);
            found.push_back(std::move(rest));
        }
        for (std::size_t b = 0; b < found.size(); ++b) {
            const std::size_t row = m * boxes + b;
            division.write(found[b], &theta[row * e * j * j], &means[row * e * j],
                           &known[row * j * corners]);
        }
    }
}

// Improve combinations of columns in every stage; their places and log p are written over.
void improve_together(const py::dict& given) {
    Jammers jammers(given);
    const Array<const double> weight(given, "weight", jammers.stages()),
        shares(given, "shares", jammers.stages() * jammers.eavesdroppers());
    const py::gil_scoped_release release;
    for (std::size_t g = 0; g < jammers.stages(); ++g)
        jammers.improve_together(g, weight[g], &shares[g * jammers.eavesdroppers()]);
}

}  // namespace

void add_bound_shares(py::module_& module) {
    module.def("bound_share_boxes", &share_boxes);
    module.def("bound_improve_together", &improve_together);
}
