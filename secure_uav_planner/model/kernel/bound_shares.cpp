// Lemma 8's boxes: how the shares and the powers of several jammers are divided. See bound/proof,
// jammer_shares.py, for what they are, and bound/search, division.py, for the arrays.
//
// What is found here may be bad, never wrong: the certificate computes every bound anew.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <tuple>
#include <vector>

#include "array.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::expect;
using kernel::size_of;

namespace {

constexpr std::size_t kJammers = 3;     // At most.
constexpr std::size_t kListeners = 3;   // Eavesdroppers at most.
constexpr std::size_t kCorners = 27;    // Of a box of shares, at most.
constexpr int kRounds = 16;             // Of a search for a better place and power.
constexpr double kFinest = 0.02;        // Share of its first steps at which such a search ends.
constexpr int kSweeps = 3;               // Of one jammer after the other.
constexpr double kFaint = 20.0;          // Of log p below the peak, where jammers are sought.
constexpr int kHalvings = 14;           // Of the interval in which the best theta are.
constexpr int kMixing = 25;             // Of a search for the corners that make up the bound.
constexpr double kAside = 0.02;         // On both sides of the best theta columns are improved.
constexpr double kActive = 0.03;              // Part of a corner from which it counts.
constexpr double kExact = 1e-4;         // In nats.
constexpr double kHuge = std::numeric_limits<double>::infinity();

// A jammer's place, log p and p, its worth without the rates, and at the receivers J x and, once
// it is among the columns, log(1 + J x).
struct Column {
    double place[2], power, watts, base, received[kListeners + 1], heard[kListeners + 1];
};

// A piece of the maximum over columns as a function of theta: the column that is best up to `end`.
struct Piece {
    std::size_t column;
    double end;
};

struct Cut {
    std::size_t first, second;  // Corners of a simplex of shares; of powers both are 0.
    double at;
};

struct Box {
    double share[kListeners][kJammers][kJammers];  // At the corners of every simplex.
    double low[kJammers], high[kJammers];          // Of log p.
    double theta[kListeners][kJammers][kJammers];  // What every simplex's corners add to theta.
    double mean[kListeners][kJammers];             // The shares at which the bound is attained.
    double known[kJammers][kCorners];
    double bound;
    Cut cut[kListeners + kJammers];
    bool useful[kListeners + kJammers];
    std::vector<Column> extra[kJammers];
};

class Problem {
public:
    explicit Problem(const py::dict& given)
        : stages_(given["stages"].cast<std::size_t>()), jammers_(size_of(given, "altitude")),
          listeners_(size_of(given, "radii") / jammers_ - 1),
          columns_(size_of(given, "power") / (jammers_ * stages_)),
          place_(given, "place", 2 * jammers_ * stages_ * columns_),
          power_(given, "power", jammers_ * stages_ * columns_),
          base_(given, "base", jammers_ * stages_ * columns_),
          pull_(given, "pull", 2 * jammers_ * stages_),
          people_(given, "people", 2 * jammers_ * (listeners_ + 1)),
          radii_(given, "radii", jammers_ * (listeners_ + 1)),
          gain_(given, "gain", jammers_ * (listeners_ + 1)),
          altitude_(given, "altitude", jammers_), distance_(given, "distance", jammers_),
          price_(given, "price", jammers_), peak_(given, "peak", jammers_),
          from_start_(given, "from_start", jammers_ * stages_),
          to_goal_(given, "to_goal", jammers_ * stages_),
          width_(given, "width", jammers_ * stages_) {
        expect(jammers_ <= kJammers && listeners_ >= 1 && listeners_ <= kListeners, "radii");
        corners_ = 1;
        for (std::size_t e = 0; e < listeners_; ++e) corners_ *= jammers_;
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            std::size_t rest = corner;
            for (std::size_t e = listeners_; e-- > 0; rest /= jammers_)
                which_[corner][e] = rest % jammers_;
        }
    }

    std::size_t jammers() const { return jammers_; }
    std::size_t listeners() const { return listeners_; }
    std::size_t corners() const { return corners_; }
    std::size_t stages() const { return stages_; }

    // Take up a stage with w0 and v.
    void begin(std::size_t stage, double weight, const double* v) {
        stage_ = stage;
        weight_ = weight;
        std::copy(v, v + listeners_, v_);
        for (std::size_t j = 0; j < jammers_; ++j) {
            own_[j].resize(columns_);
            for (std::size_t c = 0; c < columns_; ++c) {
                const std::size_t at = (j * stages_ + stage) * columns_ + c;
                own_[j][c] = {{place_[2 * at], place_[2 * at + 1]}, power_[at],
                              std::exp(power_[at]), base_[at], {}, {}};
                hear(j, own_[j][c]);
            }
        }
    }

    // Move all jammers' columns with the same number to where they are worth more together.
    void improve_together(std::size_t number) {
        for (int sweep = 0; sweep < kSweeps; ++sweep)
            for (std::size_t j = 0; j < jammers_; ++j) {
                double noise[kListeners + 1];
                for (std::size_t r = 0; r <= listeners_; ++r) {
                    noise[r] = 1.0;
                    for (std::size_t i = 0; i < jammers_; ++i)
                        if (i != j) noise[r] += own_[i][number].received[r] / double(jammers_);
                }
                const auto worth = [&](const Column& one) {
                    double value = one.base - price_[j] * one.watts;
                    for (std::size_t r = 0; r <= listeners_; ++r)
                        value += (r ? v_[r - 1] : -weight_)
                            * std::log(noise[r] + one.received[r] / double(jammers_));
                    return value;
                };
                improve(j, peak_[j] - kFaint, peak_[j], std::pow(0.3, sweep), worth,
                        own_[j][number]);
                const std::size_t at = (j * stages_ + stage_) * columns_ + number;
                std::copy(own_[j][number].place, own_[j][number].place + 2, &place_[2 * at]);
                power_[at] = own_[j][number].power;
            }
    }

    std::size_t columns() const { return columns_; }

    // Drop columns that are there twice.
    void drop_copies() {
        const auto key = [](const Column& one) {
            return std::make_tuple(one.power, one.place[0], one.place[1]);
        };
        const auto before = [&](const Column& one, const Column& two) {
            return key(one) < key(two);
        };
        const auto same = [&](const Column& one, const Column& two) {
            return key(one) == key(two);
        };
        for (std::size_t j = 0; j < jammers_; ++j) {
            std::vector<Column>& all = own_[j];
            std::sort(all.begin(), all.end(), before);
            all.erase(std::unique(all.begin(), all.end(), same), all.end());
        }
    }

    Box whole() {
        Box box{};
        for (std::size_t e = 0; e < listeners_; ++e)
            for (std::size_t j = 0; j < jammers_; ++j) box.share[e][j][j] = 1.0;
        std::fill(box.low, box.low + jammers_, -kHuge);
        std::fill(box.high, box.high + jammers_, kHuge);
        fit_well(box);
        return box;
    }

    // Cut a box as lowers it most, keep one part, return the other: false where nothing helps.
    bool split(Box& box, Box& rest, std::int64_t* side, double* at) {
        Box best;
        double score = kHuge;
        list(box);
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
                }
            } else {
                part[0].high[s - listeners_] = part[1].low[s - listeners_] = cut.at;
            }
            for (Box& one : part) {
                if (s >= listeners_) list(one);
                fit(one);
            }
            const double more = std::max(part[0].bound, part[1].bound)
                                + 1e-3 * std::min(part[0].bound, part[1].bound);
            if (!(more < score)) continue;
            score = more;
            best = std::move(part[0]);
            rest = std::move(part[1]);
            const std::size_t edges = jammers_ * jammers_;
            *side = std::int64_t(s < listeners_ ? s * edges + cut.first * jammers_ + cut.second
                                                : listeners_ * (edges - 1) + s);
            *at = cut.at;
        }
        if (score == kHuge) return false;
        box = std::move(best);
        fit_well(box);
        fit_well(rest);
        return true;
    }

private:
    void receive(std::size_t j, Column& column) const {
        const double square = altitude_[j] * altitude_[j];
        for (std::size_t r = 0; r <= listeners_; ++r) {
            const std::size_t at = j * (listeners_ + 1) + r;
            const double x = column.place[0] - people_[2 * at];
            const double y = column.place[1] - people_[2 * at + 1];
            const double d = std::sqrt(x * x + y * y) + radii_[at];
            column.received[r] = gain_[at] * column.watts / (d * d + square);
        }
    }

    void hear(std::size_t j, Column& column) const {
        receive(j, column);
        for (std::size_t r = 0; r <= listeners_; ++r)
            column.heard[r] = std::log(1 + column.received[r]);
    }

    // The weights of what receivers hear of jammer j at a corner.
    void weights(const Box& box, std::size_t j, std::size_t corner, double theta,
                 double* w) const {
        w[0] = -weight_ * theta;
        for (std::size_t e = 0; e < listeners_; ++e)
            w[e + 1] = v_[e] * box.share[e][which_[corner][e]][j];
    }

    double worth(std::size_t j, const Column& column, const double* w) const {
        double value = column.base - price_[j] * column.watts;
        for (std::size_t r = 0; r <= listeners_; ++r)
            if (w[r] != 0) value += w[r] * std::log(1 + column.received[r]);
        return value;
    }

    // List the columns with their powers drawn into a box, those that the ground hears best first.
    void list(const Box& box) {
        for (std::size_t j = 0; j < jammers_; ++j) {
            std::vector<Column>& all = listed_[j];
            all = own_[j];
            all.insert(all.end(), box.extra[j].begin(), box.extra[j].end());
            for (Column& column : all) {
                const double power = std::min(std::max(column.power, box.low[j]),
                                              std::min(box.high[j], peak_[j]));
                if (power == column.power) continue;
                column.power = power;
                column.watts = std::exp(power);
                hear(j, column);
            }
            std::sort(all.begin(), all.end(), [](const Column& one, const Column& two) {
                return one.heard[0] > two.heard[0];
            });
        }
    }

    // Find the maxima over columns at all corners as functions of theta.
    void tabulate(const Box& box) {
        double w[kListeners + 1];
        for (std::size_t j = 0; j < jammers_; ++j) {
            const std::vector<Column>& all = listed_[j];
            cost_.resize(all.size());
            for (std::size_t c = 0; c < all.size(); ++c)
                cost_[c] = all[c].base - price_[j] * all[c].watts;
            for (std::size_t corner = 0; corner < corners_; ++corner) {
                weights(box, j, corner, 0.0, w);
                std::vector<Piece>& pieces = pieces_[j][corner];
                std::vector<double>& value = value_[j][corner];
                value.resize(all.size());
                pieces.clear();
                // Lines with falling slopes: each is best up to where the next one is better.
                for (std::size_t c = 0; c < all.size(); ++c) {
                    double sum = cost_[c];
                    for (std::size_t r = 1; r <= listeners_; ++r) sum += w[r] * all[c].heard[r];
                    value[c] = sum;
                    while (!pieces.empty()) {
                        const std::size_t last = pieces.back().column;
                        // They meet where theta is the first over the second.
                        const double less = value[last] - sum, steeper = std::max(
                            weight_ * (all[last].heard[0] - all[c].heard[0]), 1e-300);
                        if (less >= steeper) break;
                        const double begin =
                            pieces.size() > 1 ? pieces[pieces.size() - 2].end : 0.0;
                        if (less > begin * steeper) {
                            pieces.back().end = less / steeper;
                            pieces.push_back({c, 1.0});
                            break;
                        }
                        pieces.pop_back();
                    }
                    if (pieces.empty()) pieces.push_back({c, 1.0});
                }
            }
        }
    }

    std::size_t best(std::size_t j, std::size_t corner, double theta) const {
        for (const Piece& piece : pieces_[j][corner])
            if (theta <= piece.end) return piece.column;
        return pieces_[j][corner].back().column;
    }

    double maximum(std::size_t j, std::size_t corner, double theta) const {
        const std::size_t c = best(j, corner, theta);
        return value_[j][corner][c] - weight_ * theta * listed_[j][c].heard[0];
    }

    // The theta that minimise F at a corner: log theta - heard is the same for all jammers.
    void best_theta(std::size_t corner, double* theta) const {
        // One theta is at least 1 / J, and one at most that, and the noise at least 1.
        double most = 1.0;
        for (std::size_t j = 0; j < jammers_; ++j)
            most = std::max(most, 1.0 + listed_[j].front().received[0]);
        double high = -std::log(double(jammers_)), low = high - std::log(most);
        for (int k = 0; k < kHalvings; ++k) {
            const double level = std::exp((low + high) / 2);
            double sum = 0.0;
            for (std::size_t j = 0; j < jammers_; ++j) {
                double begin = 0.0;
                for (const Piece& piece : pieces_[j][corner]) {
                    theta[j] = std::max(level * (1.0 + listed_[j][piece.column].received[0]), begin);
                    begin = piece.end;
                    if (theta[j] <= begin) break;
                }
                theta[j] = std::min(theta[j], 1.0);
                sum += theta[j];
            }
            (sum < 1.0 ? low : high) = (low + high) / 2;
        }
        double sum = 0.0;
        for (std::size_t j = 0; j < jammers_; ++j) sum += theta[j];
        for (std::size_t j = 0; j < jammers_; ++j) theta[j] /= sum;
    }

    // Draw a place into one disc and then into the other; return whether it is in both.
    bool draw_in(std::size_t j, double* place) const {
        const double radius[2] = {from_start_[j * stages_ + stage_], to_goal_[j * stages_ + stage_]};
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
        return excess(0) <= 1.0;
    }

    // Move a column to where it is worth more, with log p between two ends.
    template <typename Worth>
    void improve(std::size_t j, double least, double most, double share, const Worth& worth,
                 Column& column) const {
        double step = share * width_[j * stages_ + stage_] / 12, ratio = share * 0.4;
        const double least_step = kFinest * step, least_ratio = kFinest * ratio;
        double top = worth(column);
        const double* pull = &pull_[2 * (j * stages_ + stage_)];
        for (int round = 0; round < kRounds; ++round) {
            Column next = column;
            for (int move = 0; move < 6; ++move) {
                Column trial = column;
                const double sign = move % 2 ? -1 : 1;
                if (move < 4) {
                    const int axis = move / 2;
                    trial.place[axis] += sign * step;
                    if (!draw_in(j, trial.place)) continue;
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
        hear(j, column);
    }

    // Add what is better than the columns at the corners.
    void extend(Box& box) {
        double w[kListeners + 1];
        for (std::size_t j = 0; j < jammers_; ++j) {
            for (std::size_t corner = 0; corner < corners_; ++corner) {
                if (part_[corner] < kActive) continue;
                for (const double sign : {-1.0, 1.0}) {
                    const double theta = aside(j, corner, sign);
                    Column column = listed_[j][best(j, corner, theta)];
                    weights(box, j, corner, theta, w);
                    const auto worth = [&](const Column& one) { return this->worth(j, one, w); };
                    const double before = worth(column);
                    improve(j, box.low[j], std::min(box.high[j], peak_[j]), 1.0, worth, column);
                    if (worth(column) > before + 1e-5) box.extra[j].push_back(column);
                }
            }
        }
    }

    double aside(std::size_t j, std::size_t corner, double sign) const {
        return std::min(std::max(theta_[corner][j] + sign * kAside, 0.0), 1.0);
    }

    // Fit a box, and again with better columns.
    void fit_well(Box& box) {
        list(box);
        fit(box);
        extend(box);
        list(box);
        fit(box);
    }

    // Find theta, the bound and the cuts of a box by the columns that are listed.
    void fit(Box& box) {
        tabulate(box);
        for (std::size_t corner = 0; corner < corners_; ++corner)
            best_theta(corner, theta_[corner]);
        make_affine(box);
        for (std::size_t corner = 0; corner < corners_; ++corner) {
            values_[corner] = weight_ * std::log(double(jammers_));
            for (std::size_t j = 0; j < jammers_; ++j) {
                const double theta = theta_[corner][j];
                box.known[j][corner] = maximum(j, corner, theta);
                values_[corner] += box.known[j][corner];
                if (theta > 0) values_[corner] += weight_ * theta * std::log(theta);
            }
        }
        bound(box);
        choose(box);
    }

    // Make theta affine in the shares, not negative.
    void make_affine(Box& box) {
        double factor = 1.0, means[kJammers];
        for (std::size_t j = 0; j < jammers_; ++j) {
            double middle = 0.0, part[kListeners][kJammers] = {};
            for (std::size_t corner = 0; corner < corners_; ++corner) {
                middle += theta_[corner][j] / double(corners_);
                for (std::size_t e = 0; e < listeners_; ++e)
                    part[e][which_[corner][e]] +=
                        theta_[corner][j] * double(jammers_) / double(corners_);
            }
            double least = 0.0;
            for (std::size_t e = 0; e < listeners_; ++e) {
                for (std::size_t i = 0; i < jammers_; ++i) box.theta[e][i][j] = part[e][i] - middle;
                least += *std::min_element(part[e], part[e] + jammers_) - middle;
            }
            if (middle + least < 0) factor = std::min(factor, (1 - 1e-9) * middle / -least);
            means[j] = middle;
        }
        for (std::size_t e = 0; e < listeners_; ++e)
            for (std::size_t i = 0; i < jammers_; ++i)
                for (std::size_t j = 0; j < jammers_; ++j)
                    box.theta[e][i][j] = factor * box.theta[e][i][j]
                                         + means[j] / double(listeners_);
        for (std::size_t corner = 0; corner < corners_; ++corner)
            for (std::size_t j = 0; j < jammers_; ++j) {
                theta_[corner][j] = 0.0;
                for (std::size_t e = 0; e < listeners_; ++e)
                    theta_[corner][j] += box.theta[e][which_[corner][e]][j];
                theta_[corner][j] = std::min(std::max(theta_[corner][j], 0.0), 1.0);
            }
    }

    // Find the mixture of corners that attains the bound; see over_boxes.
    void bound(Box& box) {
        double total = 1e-12, mean[kListeners][kJammers], cross[kListeners][kJammers];
        for (std::size_t e = 0; e < listeners_; ++e) total += v_[e];
        std::fill(part_, part_ + corners_, 1.0 / double(corners_));
        box.bound = kHuge;
        for (int round = 0; round < kMixing; ++round) {
            for (std::size_t e = 0; e < listeners_; ++e) {
                double share[kJammers] = {};
                for (std::size_t corner = 0; corner < corners_; ++corner)
                    share[which_[corner][e]] += part_[corner];
                for (std::size_t j = 0; j < jammers_; ++j) {
                    mean[e][j] = 1e-300;
                    for (std::size_t i = 0; i < jammers_; ++i)
                        mean[e][j] += share[i] * box.share[e][i][j];
                }
                double logs[kJammers];
                for (std::size_t j = 0; j < jammers_; ++j) logs[j] = std::log(mean[e][j]);
                for (std::size_t i = 0; i < jammers_; ++i) {
                    cross[e][i] = -std::log(double(jammers_));
                    for (std::size_t j = 0; j < jammers_; ++j)
                        cross[e][i] -= box.share[e][i][j] * logs[j];
                }
            }
            double worth[kCorners], top = -kHuge, reached = 0.0;
            for (std::size_t corner = 0; corner < corners_; ++corner) {
                worth[corner] = values_[corner];
                for (std::size_t e = 0; e < listeners_; ++e)
                    worth[corner] += v_[e] * cross[e][which_[corner][e]];
                top = std::max(top, worth[corner]);
                reached += part_[corner] * worth[corner];
            }
            if (top < box.bound) {
                box.bound = top;
                std::copy(&mean[0][0], &mean[0][0] + kListeners * kJammers, &box.mean[0][0]);
            }
            if (top - reached < kExact) break;
            double sum = 0.0;
            for (std::size_t corner = 0; corner < corners_; ++corner)
                sum += part_[corner] *= std::exp(1.5 * (worth[corner] - top) / total);
            for (std::size_t corner = 0; corner < corners_; ++corner) part_[corner] /= sum;
        }
    }

    // Find where every simplex of shares and every power may be cut.
    void choose(Box& box) const {
        std::fill(box.useful, box.useful + kListeners + kJammers, false);
        for (std::size_t e = 0; e < listeners_; ++e) {
            double share[kJammers] = {}, most = 1e-6;
            for (std::size_t corner = 0; corner < corners_; ++corner)
                share[which_[corner][e]] += part_[corner];
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
                if (part_[corner] < kActive) continue;
                for (const double sign : {-1.0, 1.0}) {
                    const Column* one = &listed_[j][best(j, corner, aside(j, corner, sign))];
                    if (!quiet || one->power < quiet->power) quiet = one;
                    if (!loud || one->power > loud->power) loud = one;
                }
            }
            if (!loud || !(quiet->power < loud->power)) continue;
            // The middle of what is heard by whoever hears the louder one best.
            const double heard = *std::max_element(loud->heard, loud->heard + listeners_ + 1);
            const double gain = std::expm1(heard) / loud->watts;
            const double middle = (heard + std::log1p(gain * quiet->watts)) / 2;
            const double at = std::log(std::expm1(middle) / gain);
            box.useful[listeners_ + j] = at > box.low[j] && at < box.high[j];
            box.cut[listeners_ + j] = {0, 0, at};
        }
    }

    std::size_t stages_, jammers_, listeners_, corners_, columns_;
    Array<double> place_, power_;
    Array<const double> base_, pull_, people_, radii_, gain_, altitude_, distance_, price_, peak_,
        from_start_, to_goal_, width_;
    std::size_t stage_ = 0, which_[kCorners][kListeners];
    double weight_ = 0, v_[kListeners] = {};
    std::vector<Column> own_[kJammers], listed_[kJammers];
    std::vector<Piece> pieces_[kJammers][kCorners];
    std::vector<double> value_[kJammers][kCorners], cost_;
    double theta_[kCorners][kJammers], values_[kCorners], part_[kCorners];
};

// Divide what jammers can do at M breakpoints.
void share_boxes(const py::dict& given) {
    Problem problem(given);
    const std::size_t count = size_of(given, "stage"), e = problem.listeners();
    const std::size_t splits = size_of(given, "at") / std::max<std::size_t>(count, 1);
    const std::size_t boxes = splits + 1, corners = problem.corners(), j = problem.jammers();
    const Array<const std::int64_t> stage(given, "stage", count);
    const Array<const double> weight(given, "weight", count), shares(given, "shares", count * e),
        enough(given, "enough", count);
    const Array<std::int64_t> which(given, "box", count * splits),
        side(given, "side", count * splits);
    const Array<double> at(given, "at", count * splits),
        theta(given, "theta", count * boxes * e * j * j),
        means(given, "mean", count * boxes * e * j),
        known(given, "known", count * boxes * j * corners);
    for (std::size_t m = 0; m < count; ++m)
        expect(stage[m] >= 0 && std::size_t(stage[m]) < problem.stages(), "stage");
    const py::gil_scoped_release release;
    for (std::size_t m = 0; m < count; ++m) {
        problem.begin(std::size_t(stage[m]), weight[m], &shares[m * e]);
        problem.drop_copies();
        std::vector<Box> found{problem.whole()};
        for (std::size_t s = 0; s < splits; ++s) {
            std::size_t worst = 0;
            for (std::size_t b = 1; b < found.size(); ++b)
                if (found[b].bound > found[worst].bound) worst = b;
            Box rest;
            if (!(found[worst].bound > enough[m])
                || !problem.split(found[worst], rest, &side[m * splits + s], &at[m * splits + s]))
                break;
            which[m * splits + s] = std::int64_t(worst);
            found.push_back(std::move(rest));
        }
        for (std::size_t b = 0; b < found.size(); ++b)
            for (std::size_t i = 0; i < j; ++i) {
                for (std::size_t l = 0; l < e; ++l) {
                    const std::size_t row = ((m * boxes + b) * e + l) * j + i;
                    means[row] = found[b].mean[l][i];
                    std::copy(found[b].theta[l][i], found[b].theta[l][i] + j, &theta[row * j]);
                }
                std::copy(found[b].known[i], found[b].known[i] + corners,
                          &known[((m * boxes + b) * j + i) * corners]);
            }
    }
}

// Improve combinations of columns in every stage; their places and log p are written over.
void improve_together(const py::dict& given) {
    Problem problem(given);
    const Array<const double> weight(given, "weight", problem.stages()),
        shares(given, "shares", problem.stages() * problem.listeners());
    const py::gil_scoped_release release;
    for (std::size_t g = 0; g < problem.stages(); ++g) {
        problem.begin(g, weight[g], &shares[g * problem.listeners()]);
        for (std::size_t c = 0; c < problem.columns(); ++c) problem.improve_together(c);
    }
}

}  // namespace

void add_bound_shares(py::module_& module) {
    module.def("bound_share_boxes", &share_boxes);
    module.def("bound_improve_together", &improve_together);
}
