#include "discs.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

namespace kernel {

namespace {

constexpr int STEPS = 30;  // Newton steps of a search, which mostly ends after 5.
constexpr int RAYS = 6;    // Sectors of the first ring, and of the places where it may start.
constexpr double POINT = 1e-12;  // Radius in m up to which a disc is searched at one place.
constexpr double LEAST = 1e-300;
// Rounding. A sum of up to 32 positive terms of a few operations each is right to 1e-14 of itself.
// Places and offsets are right to `doubt`, many units in the last place of the longest offset; as
// places of a sector that widens the ball, and as places of UAVs it changes v by no more than the
// slopes of its terms allow. Where terms cancel, as in L_j, in the gradient and in the Hessian,
// the error is a few units in the last place of their absolute values added up: `change`, `slopes`
// and `lowered` hold more than that. In sum, a bound is lowered by more than rounding can raise it.
constexpr double ULPS = 1e-14;

constexpr double PI = 3.14159265358979323846, LOG_2 = 0.69314718055994530942;
constexpr double NOTHING_YET = std::numeric_limits<double>::infinity();
constexpr std::int64_t LONG = 200000;  // Sectors between two looks whether to stop.

double leak_of(double inverse) { return std::log1p(1.0 / inverse) / LOG_2; }
double inverse_of(double leak) { return 1.0 / std::expm1(leak * LOG_2); }

// v at a place, its gradient and its Hessian.
struct Derivatives {
    double value, x, y, xx, xy, yy;
};

// v around a place.
struct Expansion {
    Derivatives v;
    double first;    // v is not below it in the ball around the place,
    double lowered;  // nor below Taylor's quadratic there with a Hessian that is lower by this,
    double slack;    // less this, for rounding.
};

// One of the Pairs at a time, for any channel.
class Pair {
public:
    explicit Pair(const Pairs& pairs) : pairs_(pairs), uavs_(pairs.uavs) {
        for (Reals* numbers : {&x_, &y_, &jamming_}) numbers->resize(uavs_);
    }
    virtual ~Pair() = default;

    void choose(std::size_t pair) {
        double farthest = 0.0;
        for (int u = 0; u < uavs_; ++u) {
            const std::size_t i = u * pairs_.count + pair;
            x_[u] = pairs_.x[i];
            y_[u] = pairs_.y[i];
            farthest = std::max(farthest, x_[u] * x_[u] + y_[u] * y_[u]);
            if (u) jamming_[u] = pairs_.jamming[i - pairs_.count];
        }
        noise_ = pairs_.noise[pair];
        radius_ = pairs_.radius[pair];
        doubt_ = ULPS * (radius_ + std::sqrt(farthest));
    }

    Found nearest() const { return found(x_[0], y_[0]); }

    // Newton's method from the best of the place nearest to the transmitter, the centre, six on a
    // circle half as wide and six on the edge.
    Found likely() const {
        Found best = nearest();
        take_better(best, found(0.0, 0.0));
        for (const double share : {0.5, 1.0})
            for (int ray = 0; ray < RAYS; ++ray) {
                const double angle = ray * (2.0 * PI / RAYS);
                take_better(best, found(share * radius_ * std::cos(angle),
                                        share * radius_ * std::sin(angle)));
            }
        return descend(best);
    }

    // Newton's method in the disc, and along its edge where v falls outwards; each step is limited,
    // and moves against the slope also where v is not convex.
    Found descend(Found here) const {
        double longest = 0.5 * radius_;
        if (!(radius_ > POINT)) return here;
        for (int step = 0; step < STEPS; ++step) {
            const Found next = newton_step(here, longest);
            const double gain = here.v - next.v;
            const bool fallen = next.v < here.v;
            const bool going = fallen ? gain > 1e-7 * here.v : 0.25 * longest > 1e-4 * radius_;
            take_better(here, next);
            longest *= fallen ? 2.0 : 0.25;
            // Newton's next gain is of the order of the square of this one.
            if (!going) break;
        }
        return here;
    }

    // A lower bound of v in a sector, and v at a place of it.
    //
    // The bound is the largest of three, all for the smallest ball around the place that holds the
    // sector. The first takes every distance by itself at its smallest or largest; of it a link
    // needs no more than a gain that falls with the distance. The others minimise a quadratic that
    // v does not fall below, Taylor's with its Hessian lowered by what the third derivative can
    // change: over the sector with its curved edges, by the Hessian's least eigenvalue alone, and
    // over the square around the ball along the eigenvectors. So what is left to divide shrinks
    // with the square of the sectors' size, both near a maximum of the leak on the edge of the
    // disc and near one inside, even if it is flat in a direction.
    double least_in(const Sector& sector, Found& at) {
        const double cosine = std::cos(sector.middle), sine = std::sin(sector.middle);
        const double radius = sector.whole() ? 0.0 : 0.5 * (sector.inner + sector.outer);
        const double bow = std::pow(std::sin(0.5 * sector.half), 2);
        const double out = sector.outer - radius;
        const double ball = std::sqrt(out * out + 4.0 * sector.outer * radius * bow)
            * (1.0 + ULPS) + doubt_;
        at.x = radius * cosine;
        at.y = radius * sine;
        const Expansion found = expanded(at.x, at.y, ball);
        at.v = found.v.value;
        const double fall = least_fall(
            found.v, sector, radius, bow, cosine, sine, ball, found.lowered);
        const double second = found.v.value * (1.0 - ULPS) + fall - found.slack;
        return second > found.first ? second : found.first;
    }

protected:
    static double square(double number) { return number * number; }

    virtual double value_at(double x, double y) const = 0;
    virtual Derivatives derivatives_at(double x, double y) const = 0;
    virtual Expansion expanded(double x, double y, double ball) const = 0;

    const Pairs& pairs_;
    const int uavs_;
    double noise_ = 0.0, radius_ = 0.0, doubt_ = 0.0;
    Reals x_, y_, jamming_;  // Of the pair.

private:
    static void take_better(Found& best, const Found& other) {
        if (other.v < best.v) best = other;
    }

    // The place of the disc that is nearest to one.
    Found found(double x, double y) const {
        const double share = std::min(1.0, radius_ / std::max(std::hypot(x, y), LEAST));
        x *= share;
        y *= share;
        return {value_at(x, y), x, y};
    }

    Found newton_step(const Found& here, double longest) const {
        double x = here.x, y = here.y;
        const Derivatives v = derivatives_at(x, y);
        const double pull = (v.x * x + v.y * y) / radius_;
        // Along the eigenvectors of the Hessian, or only along the edge, whose curvature counts
        // too.
        const bool edge = std::hypot(x, y) >= (1.0 - 1e-9) * radius_ && pull < 0.0;
        const double angle =
            edge ? std::atan2(x, -y) : 0.5 * std::atan2(2.0 * v.xy, v.xx - v.yy);
        const double cosine = std::cos(angle), sine = std::sin(angle);
        const auto go = [&](double along, double across, double extra) {
            const double slope = v.x * along + v.y * across;
            const double bend = along * along * v.xx + 2.0 * along * across * v.xy
                + across * across * v.yy - extra;
            const double step = -slope
                / std::max({std::fabs(bend), std::fabs(slope) / longest, LEAST});
            x += step * along;
            y += step * across;
        };
        go(cosine, sine, edge ? pull / radius_ : 0.0);
        if (!edge) go(-sine, cosine, 0.0);
        return found(x, y);
    }

    // A lower bound of the quadratic less its value at the place.
    static double least_fall(const Derivatives& v, const Sector& sector, double radius,
                             double bow, double cosine, double sine, double ball,
                             double lowered) {
        const double mean = 0.5 * (v.xx + v.yy), half = 0.5 * (v.xx - v.yy);
        const double spread = std::hypot(half, v.xy);
        const double angle = 0.5 * std::atan2(v.xy, half);
        const double turned_cosine = std::cos(angle), turned_sine = std::sin(angle);
        double fall = 0.0;
        const auto add = [&](double across_x, double across_y, double bend) {
            const double slope = std::fabs(v.x * across_x + v.y * across_y);
            const double step = slope < bend * ball ? slope / bend : ball;
            fall += step * (0.5 * bend * step - slope);
        };
        add(turned_cosine, turned_sine, mean + spread - lowered);
        add(-turned_sine, turned_cosine, mean - spread - lowered);

        // On the arc at r, at (r, middle + t), the quadratic falls by a term of r, and by r times
        // along (cos t - 1) + across sin t. This is least where its steepest descent points, if
        // that is within the angle, or else at an end; over r the whole is concave, and so least
        // on one of the two arcs.
        const double concave = std::max(lowered + spread - mean, 0.0);
        const double outwards = v.x * cosine + v.y * sine;
        const double along = outwards + concave * radius;
        const double across = std::fabs(v.y * cosine - v.x * sine);
        const double steepest = std::hypot(along, across);
        const double sine_half = std::sin(sector.half);
        double turn = -2.0 * along * bow - across * sine_half;
        if (sector.whole() || across * std::cos(sector.half) <= -along * sine_half)
            turn = along < 0.0
                ? -across * (across / std::max(steepest + std::fabs(along), LEAST))
                : -along - steepest;
        double on_arcs = NOTHING_YET;
        for (const double edge : {sector.inner, sector.outer}) {
            const double step = edge - radius;
            on_arcs = std::min(
                on_arcs, step * (outwards - 0.5 * concave * step) + edge * turn);
        }
        return std::max(fall, on_arcs);
    }
};

// In free space.
class FreeSpacePair final : public Pair {
public:
    explicit FreeSpacePair(const Pairs& pairs) : Pair(pairs) {
        for (Reals* numbers : {&dx_, &dy_, &distance_, &loss_}) numbers->resize(uavs_);
    }

protected:
    double value_at(double x, double y) const override {
        const auto loss_at = [&](int u) { return loss(square(x - x_[u]) + square(y - y_[u]), u); };
        double sum = noise_;
        for (int j = 1; j < uavs_; ++j) sum += jamming_[j] / loss_at(j);
        return loss_at(0) * sum;
    }

    Derivatives derivatives_at(double x, double y) const override {
        go_to(x, y);
        return derivatives();
    }

    Expansion expanded(double x, double y, double ball) const override {
        const Reals& altitudes = pairs_.squared_altitudes;
        go_to(x, y);
        for (int u = 0; u < uavs_; ++u)
            distance_[u] = std::sqrt(dx_[u] * dx_[u] + dy_[u] * dy_[u]);
        const double best = loss(square(std::max(distance_[0] - ball, 0.0)), 0);
        double first = noise_ * best, third = 0.0;
        double doubtful = noise_, weights = noise_, slopes = 0.0;
        for (int j = 1; j < uavs_; ++j) {
            const double near = loss(square(std::max(distance_[j] - ball, 0.0)), j);
            const double far = loss(square(distance_[j] + ball), j);
            // From q_0 to q_j, and L_j with how much it changes in the ball.
            const double apart_x = x_[j] - x_[0], apart_y = y_[j] - y_[0];
            const double apart = std::sqrt(apart_x * apart_x + apart_y * apart_y) + doubt_;
            const double change =
                2.0 * apart * (ball + ULPS * (distance_[0] + distance_[j]));
            const double difference = apart_x * (dx_[0] + dx_[j]) + apart_y * (dy_[0] + dy_[j])
                + (altitudes[0] - altitudes[j]);
            const double lowest = difference - change;
            first += jamming_[j]
                * std::max(best / far, 1.0 + lowest / (lowest > 0.0 ? far : near));
            // Along a line, |(1 / D)''| <= 6 / D^2, |(1 / D)'''| <= 24 / D^(5/2); L_j is affine.
            third += jamming_[j] / (near * near)
                * (24.0 * (std::fabs(difference) + change) / std::sqrt(near) + 36.0 * apart);
            const double weight = jamming_[j] / loss_[j], ratio = loss_[0] / loss_[j];
            doubtful += weight * (1.0 + ratio);
            weights += weight;
            slopes += weight * ratio * distance_[j];
        }
        first *= 1.0 - ULPS;
        slopes += weights * distance_[0];
        return {derivatives(), first, third * ball / 3.0 + ULPS * doubtful,
                2.0 * slopes * (doubt_ + ULPS * ball)};
    }

private:
    // D of a UAV, at a squared distance.
    double loss(double squared, int u) const {
        return FreeSpace::loss(squared, pairs_.squared_altitudes[u]);
    }

    void go_to(double x, double y) const {
        for (int u = 0; u < uavs_; ++u) {
            dx_[u] = x - x_[u];
            dy_[u] = y - y_[u];
            loss_[u] = loss(dx_[u] * dx_[u] + dy_[u] * dy_[u], u);
        }
    }

    // At the place gone to.
    Derivatives derivatives() const {
        const double *dx = dx_.data(), *dy = dy_.data(), *loss = loss_.data();
        double sum = noise_, isotropic = noise_, slope_x = 0.0, slope_y = 0.0;
        double xx = 0.0, xy = 0.0, yy = 0.0;
        for (int j = 1; j < uavs_; ++j) {
            const double weight = jamming_[j] / loss[j], ratio = loss[0] / loss[j];
            // Half the gradient of D_0 / D_j is (x - q_0 - (D_0 / D_j) (x - q_j)) / D_j.
            const double along_x = weight * (dx[0] - ratio * dx[j]);
            const double along_y = weight * (dy[0] - ratio * dy[j]);
            const double shift_x = 2.0 * dx[j] / loss[j], shift_y = 2.0 * dy[j] / loss[j];
            sum += weight;
            isotropic += weight * (1.0 - ratio);
            slope_x += along_x;
            slope_y += along_y;
            xx += along_x * shift_x;
            xy += along_x * shift_y + along_y * shift_x;
            yy += along_y * shift_y;
        }
        return {loss[0] * sum, 2.0 * (noise_ * dx[0] + slope_x), 2.0 * (noise_ * dy[0] + slope_y),
                2.0 * (isotropic - 2.0 * xx), -2.0 * xy, 2.0 * (isotropic - 2.0 * yy)};
    }

    mutable Reals dx_, dy_, distance_, loss_;  // Of the place gone to; distances of an expansion.
};

// With a PathLoss. The derivatives of a term g_j / g_0 are its products with those of the
// difference of log g_j and log g_0.
class PathLossPair final : public Pair {
public:
    explicit PathLossPair(const Pairs& pairs) : Pair(pairs), channel_(*pairs.channel) {}

protected:
    double value_at(double x, double y) const override {
        const auto gain = [&](int u) {
            return channel_.gain(u, square(x - x_[u]) + square(y - y_[u]));
        };
        double sum = noise_;
        for (int j = 1; j < uavs_; ++j) sum += jamming_[j] * gain(j);
        return sum / gain(0);
    }

    Derivatives derivatives_at(double x, double y) const override {
        Derivatives found{};
        const Logarithm own = logarithm(x, y, 0);
        add(found, noise_, less(ONE, own));
        for (int j = 1; j < uavs_; ++j) add(found, jamming_[j], less(logarithm(x, y, j), own));
        return found;
    }

    Expansion expanded(double x, double y, double ball) const override {
        const Logarithm own = logarithm(x, y, 0);
        const Range mine = range(0, own, ball);
        Expansion found{};
        double third = 0.0, second = 0.0, doubtful = 0.0;
        for (int u = 0; u < uavs_; ++u) {
            const double weight = u ? jamming_[u] : noise_;
            const Logarithm theirs = u ? logarithm(x, y, u) : ONE;
            const Logarithm of = less(theirs, own);
            Range in{1.0, 1.0, {}};
            if (u) in = range(u, theirs, ball);
            const double bend = in.slopes.second + mine.slopes.second;
            const double twist = in.slopes.third + mine.slopes.third;
            double slope = in.slopes.first + mine.slopes.first;
            // Of UAVs that are close together most of the slope cancels.
            slope = std::min(slope, std::hypot(of.x, of.y) + ball * bend + GAIN_ULPS * slope);
            const double curved = bend + slope * slope;
            const double cubed = twist + 3.0 * slope * bend + slope * slope * slope;
            found.first += weight
                * std::max(in.least / mine.most, of.gain * std::exp(-ball * slope));
            const double most = weight * in.most / mine.least;
            third += most * cubed;
            second += most * curved;
            doubtful += most * (slope + ball * (curved + ball * cubed));
            add(found.v, weight, of);
        }
        found.first *= 1.0 - GAIN_ULPS;
        found.lowered = third * ball / 3.0 + GAIN_ULPS * second;
        found.slack = GAIN_ULPS * found.v.value
            + 4.0 * doubtful * (doubt_ + GAIN_ULPS * ball);
        if (!(found.lowered < NOTHING_YET)) {  // Above a kink.
            found.lowered = 0.0;
            found.slack = NOTHING_YET;
        }
        return found;
    }

private:
    // More than the rounding of a gain, of its powers and exponentials.
    static constexpr double GAIN_ULPS = 1e-12;

    // A gain at a distance, and gradient and Hessian of its logarithm.
    struct Logarithm {
        double gain, x, y, xx, xy, yy, distance;
    };
    static constexpr Logarithm ONE{1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};

    // Between what a gain is in a ball, and bounds of the derivatives of its logarithm there.
    struct Range {
        double least, most;
        PathLoss::Slopes slopes;
    };

    Range range(int u, const Logarithm& at, double ball) const {
        const double near = std::max(at.distance - ball, 0.0), far = at.distance + ball;
        return {channel_.gain(u, far * far), channel_.gain(u, near * near),
                channel_.slopes(u, near, far)};
    }

    Logarithm logarithm(double x, double y, int u) const {
        const double dx = x - x_[u], dy = y - y_[u], squared = dx * dx + dy * dy;
        const Gain gain = channel_.derivatives(u, squared);
        const double slope = gain.first / gain.value;
        const double bend = 4.0 * (gain.second / gain.value - slope * slope);
        return {gain.value, 2.0 * slope * dx, 2.0 * slope * dy, 2.0 * slope + bend * dx * dx,
                bend * dx * dy, 2.0 * slope + bend * dy * dy, std::sqrt(squared)};
    }

    static Logarithm less(const Logarithm& one, const Logarithm& other) {
        return {one.gain / other.gain, one.x - other.x, one.y - other.y, one.xx - other.xx,
                one.xy - other.xy, one.yy - other.yy, 0.0};
    }

    static void add(Derivatives& sum, double weight, const Logarithm& of) {
        const double term = weight * of.gain;
        sum.value += term;
        sum.x += term * of.x;
        sum.y += term * of.y;
        sum.xx += term * (of.x * of.x + of.xx);
        sum.xy += term * (of.x * of.y + of.xy);
        sum.yy += term * (of.y * of.y + of.yy);
    }

    const PathLoss& channel_;
};

std::unique_ptr<Pair> make_pair(const Pairs& pairs) {
    if (pairs.channel) return std::make_unique<PathLossPair>(pairs);
    return std::make_unique<FreeSpacePair>(pairs);
}

// The branch and bound of one slot after the other.
class Search {
public:
    Search(const Pairs& pairs, const Proof& proof)
        : pair_(make_pair(pairs)), pairs_(pairs), proof_(proof) {}

    // Examine the pairs from one to before another, all of one slot; return how many sectors
    // that took.
    std::int64_t examine(std::size_t slot, std::size_t begin, std::size_t end) {
        least_ = {NOTHING_YET, 0.0, 0.0};
        alive_.clear();
        for (std::size_t pair = begin; pair < end; ++pair) alive_.push_back(pair);
        for (const bool likely : {false, true}) {
            for (const std::size_t pair : alive_) {
                pair_->choose(pair);
                offer(pair, likely ? pair_->likely() : pair_->nearest());
            }
            const double enough = leak_of(least_.v) + proof_.tolerance;
            alive_.erase(std::remove_if(alive_.begin(), alive_.end(), [&](std::size_t pair) {
                return !(proof_.most[pair] > enough);
            }), alive_.end());
        }
        double leak = 0.0;
        for (std::size_t pair = begin; pair < end; ++pair)
            if (!std::binary_search(alive_.begin(), alive_.end(), pair))
                leak = std::max(leak, proof_.most[pair]);
        level_.clear();
        for (const std::size_t pair : alive_)
            level_.push_back({pair, 0.0, pairs_.radius[pair], 0.0, PI,
                              inverse_of(proof_.most[pair])});
        double proven = NOTHING_YET;
        std::int64_t examined = 0;
        while (!level_.empty()) {
            examined += std::int64_t(level_.size());
            bound_level();
            const double enough = inverse_of(leak_of(least_.v) + proof_.tolerance);
            next_.clear();
            for (const Sector& sector : level_) {
                if (sector.bound < enough && examined < proof_.most_sectors) divide(sector);
                else proven = std::min(proven, sector.bound);
            }
            level_.swap(next_);
        }
        proof_.leaks[slot] = std::max(leak, leak_of(std::min(proven, least_.v)));
        proof_.pair[slot] = std::int64_t(best_);
        proof_.place[2 * slot] = least_.x;
        proof_.place[2 * slot + 1] = least_.y;
        return examined;
    }

private:
    void offer(std::size_t pair, const Found& found) {
        if (!(found.v < least_.v)) return;
        least_ = found;
        best_ = pair;
    }

    // Bound v in all sectors of a level, and search on from the least v found in them.
    void bound_level() {
        Found best = least_;
        std::size_t from = best_, chosen = pairs_.count;
        for (Sector& sector : level_) {
            if (sector.pair != chosen) pair_->choose(chosen = sector.pair);
            Found at;
            const double bound = pair_->least_in(sector, at);
            // A part has no smaller v than the whole. What is no number proves nothing.
            if (bound > sector.bound) sector.bound = bound;
            if (at.v < best.v) {
                best = at;
                from = sector.pair;
            }
        }
        if (!(best.v < least_.v)) return;
        pair_->choose(from);
        offer(from, pair_->descend(best));
    }

    // Add the parts of a sector to the next level: of a disc its inner half and six more.
    void divide(const Sector& sector) {
        const double middle = 0.5 * (sector.inner + sector.outer);
        Sector part = sector;
        if (sector.whole()) {
            part.outer = middle;
            part.half = PI;
            next_.push_back(part);
            part.inner = middle;
            part.outer = sector.outer;
            part.half = PI / RAYS;
            for (int ray = 1; ray <= RAYS; ++ray) {
                part.middle = sector.middle + ray * (2.0 * PI / RAYS);
                next_.push_back(part);
            }
            return;
        }
        part.half = 0.5 * sector.half;
        for (const double turn : {-part.half, part.half}) {
            part.middle = sector.middle + turn;
            part.inner = sector.inner;
            part.outer = middle;
            next_.push_back(part);
            part.inner = middle;
            part.outer = sector.outer;
            next_.push_back(part);
        }
    }

    std::unique_ptr<Pair> pair_;
    const Pairs& pairs_;
    const Proof& proof_;
    Found least_{};
    std::size_t best_ = 0;
    std::vector<std::size_t> alive_;
    std::vector<Sector> level_, next_;
};

}  // namespace

Found bound_sector(const Pairs& pairs, Sector& sector) {
    const std::unique_ptr<Pair> pair = make_pair(pairs);
    pair->choose(sector.pair);
    Found at;
    sector.bound = std::max(sector.bound, pair->least_in(sector, at));
    return at;
}

void likely_places(const Pairs& pairs, double* v, double* x, double* y) {
    const std::unique_ptr<Pair> pair = make_pair(pairs);
    for (std::size_t i = 0; i < pairs.count; ++i) {
        pair->choose(i);
        const Found found = pair->likely();
        v[i] = found.v;
        x[i] = found.x;
        y[i] = found.y;
    }
}

void prove(const Pairs& pairs, const Proof& proof, const std::function<void()>& wait) {
    Search search(pairs, proof);
    std::int64_t examined = 0;
    for (std::size_t begin = 0; begin < pairs.count;) {
        std::size_t end = begin;
        while (end < pairs.count && proof.slot[end] == proof.slot[begin]) ++end;
        examined += search.examine(std::size_t(proof.slot[begin]), begin, end) + 1;
        begin = end;
        if (examined < LONG) continue;
        wait();
        examined = 0;
    }
}

}  // namespace kernel
