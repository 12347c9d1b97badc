// A flange measured with PCL as an engineer would who knows the part and roughly where it lies.
//
// pcl_pipeline CLOUD JOB REPEATS THREADS SOR CUT -> one JSON document on standard output.
// CLOUD: raw float32 (N, 3), millimetres. JOB: text, numbers apart by blanks: near far, taught pose (16, row by row),
// count, then x y mouth_radius of each hole in the part frame. The clock runs from the buffer in memory to the result.
#include <pcl/common/io.h>
#include <pcl/filters/extract_indices.h>
#include <pcl/filters/filter.h>
#include <pcl/filters/passthrough.h>
#include <pcl/filters/statistical_outlier_removal.h>
#include <pcl/point_types.h>
#include <pcl/segmentation/sac_segmentation.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

constexpr double TAU_MM = 0.1;
constexpr int NEIGHBOURS = 20;
constexpr double STD_RATIO = 2.0;
constexpr double AROUND_MM = 1.5;
constexpr double HEIGHT_TOLERANCE_MM = 1.5;
constexpr int MOST_PLANES = 4;

struct Job {
    double near_mm = 0.0, far_mm = 0.0;
    Eigen::Matrix4d taught = Eigen::Matrix4d::Identity();
    std::vector<Eigen::Vector2d> places;
    std::vector<double> mouths;
};

struct Result {
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    std::vector<Eigen::Vector3d> centres;  // NaN where not found
};

static double thread_s() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

static void print(const char* name, const std::vector<double>& seconds) {
    std::printf("\"%s\": [", name);
    for (std::size_t i = 0; i < seconds.size(); ++i) std::printf("%s%.6f", i ? ", " : "", seconds[i]);
    std::printf("], ");
}

static long status_kib(const std::string& key) {
    std::ifstream status("/proc/self/status");
    for (std::string line; std::getline(status, line);)
        if (line.rfind(key, 0) == 0) return std::atol(line.c_str() + key.size() + 1);
    return 0;
}

static Job read_job(const char* path) {
    std::ifstream file(path);
    Job job;
    std::size_t count = 0;
    file >> job.near_mm >> job.far_mm;
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column) file >> job.taught(row, column);
    file >> count;
    for (std::size_t i = 0; i < count; ++i) {
        double x, y, mouth;
        file >> x >> y >> mouth;
        job.places.emplace_back(x, y);
        job.mouths.push_back(mouth);
    }
    if (!file) {
        std::fprintf(stderr, "%s: not a job\n", path);
        std::exit(2);
    }
    return job;
}

static std::vector<float> read_cloud(const char* path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    std::vector<float> raw(static_cast<std::size_t>(file.tellg()) / sizeof(float));
    file.seekg(0);
    file.read(reinterpret_cast<char*>(raw.data()), static_cast<std::streamsize>(raw.size() * sizeof(float)));
    return raw;
}

// What is valid, as a PCL cloud; with `cut` only what lies near the working distance.
static Cloud::Ptr prepared(const std::vector<float>& raw, const Job& job, bool sor, bool cut) {
    Cloud::Ptr cloud(new Cloud);
    cloud->resize(raw.size() / 3);
    for (std::size_t i = 0; i < cloud->size(); ++i) (*cloud)[i].getVector3fMap() = Eigen::Map<const Eigen::Vector3f>(&raw[3 * i]);
    cloud->is_dense = false;
    Cloud::Ptr kept(new Cloud);
    if (cut) {
        pcl::PassThrough<pcl::PointXYZ> pass;
        pass.setInputCloud(cloud);
        pass.setFilterFieldName("z");
        pass.setFilterLimits(static_cast<float>(job.near_mm), static_cast<float>(job.far_mm));
        pass.filter(*kept);
    } else {
        pcl::Indices indices;
        pcl::removeNaNFromPointCloud(*cloud, *kept, indices);
    }
    cloud.reset();
    if (!sor) return kept;
    pcl::StatisticalOutlierRemoval<pcl::PointXYZ> filter;
    filter.setInputCloud(kept);
    filter.setMeanK(NEIGHBOURS);
    filter.setStddevMulThresh(STD_RATIO);
    Cloud::Ptr clean(new Cloud);
    filter.filter(*clean);
    return clean;
}

// The face: planes by RANSAC, the largest first, until one lies where the part was taught.
static Cloud::Ptr face_of(Cloud::Ptr cloud, const Job& job, int threads, Eigen::Vector3d& normal) {
    const Eigen::Vector3d place = job.taught.block<3, 1>(0, 3);
    for (int tries = 0; tries < MOST_PLANES; ++tries) {
        pcl::SACSegmentation<pcl::PointXYZ> segmentation;
        segmentation.setModelType(pcl::SACMODEL_PLANE);
        segmentation.setMethodType(pcl::SAC_RANSAC);
        segmentation.setDistanceThreshold(TAU_MM);
        segmentation.setMaxIterations(1000);
        segmentation.setOptimizeCoefficients(true);
        if (threads > 1) segmentation.setNumberOfThreads(threads);
        segmentation.setInputCloud(cloud);
        pcl::ModelCoefficients plane;
        pcl::PointIndices::Ptr inliers(new pcl::PointIndices);
        segmentation.segment(*inliers, plane);
        if (inliers->indices.empty()) break;
        normal = Eigen::Vector3d(plane.values[0], plane.values[1], plane.values[2]);
        const double height = (normal.dot(place) + plane.values[3]) / normal.norm();
        normal.normalize();
        if (normal.z() > 0) normal = -normal;
        pcl::ExtractIndices<pcl::PointXYZ> extract;
        extract.setInputCloud(cloud);
        extract.setIndices(inliers);
        Cloud::Ptr part(new Cloud);
        if (std::abs(height) < HEIGHT_TOLERANCE_MM) {
            extract.filter(*part);
            return part;
        }
        extract.setNegative(true);
        extract.filter(*part);
        cloud = part;
    }
    std::fprintf(stderr, "no plane lies where the part was taught\n");
    std::exit(3);
}

// Circle through the outline: in each sector, two points wide, the face point nearest to the hole's middle.
static bool hole_at(const std::vector<Eigen::Vector2d>& window, double mouth, Eigen::Vector2d& centre) {
    const double area = M_PI * (std::pow(mouth + AROUND_MM, 2) - mouth * mouth);
    const double spacing = std::sqrt(area / std::max<double>(1.0, window.size()));
    const int sectors = std::max(8, static_cast<int>(M_PI * mouth / spacing));
    for (int round = 0; round < 3; ++round) {
        std::vector<double> nearest(sectors, std::numeric_limits<double>::max());
        std::vector<int> chosen(sectors, -1);
        for (std::size_t i = 0; i < window.size(); ++i) {
            const Eigen::Vector2d away = window[i] - centre;
            const double share = std::atan2(away.y(), away.x()) / (2.0 * M_PI) + 0.5, rho = away.norm();
            const int sector = static_cast<int>(share * sectors) % sectors;
            if (rho < nearest[sector]) nearest[sector] = rho, chosen[sector] = static_cast<int>(i);
        }
        Cloud::Ptr outline(new Cloud);
        for (int i : chosen)
            if (i >= 0) outline->emplace_back(float(window[i].x()), float(window[i].y()), 0.0f);
        if (outline->size() < std::max<std::size_t>(6, sectors / 3)) return false;
        pcl::SACSegmentation<pcl::PointXYZ> segmentation;
        segmentation.setModelType(pcl::SACMODEL_CIRCLE2D);
        segmentation.setMethodType(pcl::SAC_RANSAC);
        segmentation.setDistanceThreshold(spacing);
        segmentation.setMaxIterations(200);
        segmentation.setOptimizeCoefficients(true);
        segmentation.setInputCloud(outline);
        pcl::ModelCoefficients circle;
        pcl::PointIndices inliers;
        segmentation.segment(inliers, circle);
        if (inliers.indices.empty()) return false;
        centre = Eigen::Vector2d(circle.values[0], circle.values[1]);
    }
    return true;
}

static Result measure(const std::vector<float>& raw, const Job& job, bool sor, bool cut, int threads) {
    Result result;
    const Cloud::Ptr face = face_of(prepared(raw, job, sor, cut), job, threads, result.normal);
    const Eigen::Vector3d x = job.taught.block<3, 1>(0, 0), place = job.taught.block<3, 1>(0, 3);
    Eigen::Vector3d origin = Eigen::Vector3d::Zero();
    for (const auto& point : *face) origin += point.getVector3fMap().cast<double>();
    origin /= static_cast<double>(face->size());
    Eigen::Matrix<double, 2, 3> axes;
    axes.row(0) = (x - x.dot(result.normal) * result.normal).normalized();
    axes.row(1) = result.normal.cross(axes.row(0).transpose());
    std::vector<Eigen::Vector2d> places;
    for (const auto& p : job.places) {
        const Eigen::Vector3d at = place + job.taught.block<3, 2>(0, 0) * p;
        places.push_back(axes * (at - origin));
    }
    Eigen::Vector2d middle = Eigen::Vector2d::Zero();
    for (const auto& p : places) middle += p / static_cast<double>(places.size());
    double low = std::numeric_limits<double>::max(), high = 0.0;
    for (const auto& p : places) low = std::min(low, (p - middle).norm()), high = std::max(high, (p - middle).norm());
    const double widest = *std::max_element(job.mouths.begin(), job.mouths.end()) + AROUND_MM;
    std::vector<Eigen::Vector2d> ring;
    for (const auto& point : *face) {
        const Eigen::Vector2d p = axes * (point.getVector3fMap().cast<double>() - origin);
        const double rho = (p - middle).norm();
        if (rho > low - widest && rho < high + widest) ring.push_back(p);
    }
    for (std::size_t i = 0; i < places.size(); ++i) {
        const double reach = job.mouths[i] + AROUND_MM;
        std::vector<Eigen::Vector2d> window;
        for (const auto& q : ring)
            if ((q - places[i]).squaredNorm() < reach * reach) window.push_back(q);
        Eigen::Vector2d centre = places[i];
        const bool found = hole_at(window, job.mouths[i], centre);
        result.centres.push_back(found ? Eigen::Vector3d(origin + axes.transpose() * centre)
                                       : Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
    }
    return result;
}

static void print(const Result& result) {
    std::printf("\"normal\": [%.12g, %.12g, %.12g], \"centres\": [", result.normal.x(), result.normal.y(), result.normal.z());
    for (std::size_t i = 0; i < result.centres.size(); ++i) {
        const auto& c = result.centres[i];
        std::printf(i ? ", " : "");
        if (std::isnan(c.x())) std::printf("null");
        else std::printf("[%.9f, %.9f, %.9f]", c.x(), c.y(), c.z());
    }
    std::printf("]");
}

int main(int argc, char** argv) {
    if (argc != 7) {
        std::fprintf(stderr, "usage: pcl_pipeline CLOUD JOB REPEATS THREADS SOR CUT\n");
        return 2;
    }
    const Job job = read_job(argv[2]);
    const int repeats = std::atoi(argv[3]), threads = std::atoi(argv[4]);
    const bool sor = std::atoi(argv[5]) != 0, cut = std::atoi(argv[6]) != 0;
    const long before = status_kib("VmRSS:");
    const std::vector<float> raw = read_cloud(argv[1]);
    std::vector<double> wall, cpu, thread;
    Result result;
    long peak = 0;
    for (int i = 0; i < repeats; ++i) {
        const auto begin = std::chrono::steady_clock::now();
        const std::clock_t ticks = std::clock();
        const double own = thread_s();
        result = measure(raw, job, sor, cut, threads);
        thread.push_back(thread_s() - own);
        cpu.push_back(double(std::clock() - ticks) / CLOCKS_PER_SEC);
        wall.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
        if (i == 0) peak = status_kib("VmHWM:");
    }
    std::printf("{");
    print("wall_s", wall);
    print("cpu_s", cpu);
    print("thread_s", thread);
    std::printf("\"peak_mib\": %.2f, ", double(peak - before) / 1024.0);
    print(result);
    std::printf("}\n");
    return 0;
}
